"""One pass of a solver over a recording: what it starts from, limits, measurement."""
