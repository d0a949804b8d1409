"""Rows and their shards: stored, resumed, compared."""
