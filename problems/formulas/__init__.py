"""Formulas of the steps: multistep methods and their kernels."""
