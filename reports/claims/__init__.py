"""Reports on single claims."""
