"""Scenes whose answer is known: one file each, read by other engines as well."""
