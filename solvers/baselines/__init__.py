"""What the paper is compared with: the velocity form, enumeration, Gauss–Seidel."""
