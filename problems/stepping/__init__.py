"""Algorithm 1: the stepper, its velocity step, events, compiled quiet steps."""
