"""Algorithm 2 of the paper: `lotstedt` as it is printed, `glambda` as we made it."""
