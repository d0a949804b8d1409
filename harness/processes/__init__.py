"""Live processes: each solver in one of its own, watched, and replaced when it dies."""
