"""Campaigns about single claims: growth, stability, convergence, Painlevé."""
