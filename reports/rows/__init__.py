"""Stored results as tables of rows."""
