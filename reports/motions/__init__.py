"""Reports on motions: frames, closed loops."""
