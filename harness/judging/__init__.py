"""The judge, apart from the judged: bounds, references, proofs, physics."""
