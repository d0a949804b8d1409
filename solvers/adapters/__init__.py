"""Off-the-shelf and simple backends, one file per package."""
