"""Algorithm 2 where A is sparse."""
