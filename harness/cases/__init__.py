"""Scenes with known answers: what the stepper makes of them."""
