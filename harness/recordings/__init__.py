"""Recordings: the QPs of a run in one HDF5 file, with a digest."""
