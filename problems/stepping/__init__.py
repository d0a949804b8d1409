"""Algorithm 1: compiled steps, their driver, events, the stepper."""
