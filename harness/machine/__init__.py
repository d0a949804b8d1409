"""The machine that results are made on: what it is, its threads and memory, its clock."""
