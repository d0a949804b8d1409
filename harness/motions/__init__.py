"""Closed loop: backends that drive the motion."""
