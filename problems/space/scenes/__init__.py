"""Scenes in space."""
