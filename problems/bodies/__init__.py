"""Bodies, their shapes, paths and forces."""
