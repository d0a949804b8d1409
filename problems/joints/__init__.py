"""Constraints that stay: pins, rods, guides, welds, gears, blades, and stops that limit them."""
