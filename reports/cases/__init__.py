"""Scenes with known answers, as a table."""
