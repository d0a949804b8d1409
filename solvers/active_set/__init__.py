"""The paper's method: algorithm 2 with conjugate gradients on an old factorisation."""
