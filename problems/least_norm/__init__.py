"""Multipliers of least norm (4.8), and when they are needed."""
