"""Friction and impulses: rules, passes, Coulomb's law as an LCP."""
