"""The method where A is sparse."""
