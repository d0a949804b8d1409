"""Stored results → tables, figures and a page.  Runs no solver."""
