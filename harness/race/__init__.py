"""Packages called by hand, one QP right after the other: a race beside the replay."""
