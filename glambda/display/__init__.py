"""What the command line prints: tables, and in words what a run or a recording is."""
