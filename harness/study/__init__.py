"""Studies: record, replay, verify and all of it at once, here or on a cluster."""
