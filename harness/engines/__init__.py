"""QPs that other engines pose, recorded from their own motions."""
