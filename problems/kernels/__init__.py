"""How kernels are compiled, and the room that they work in."""
