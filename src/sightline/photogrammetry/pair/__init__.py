"""Linear estimates from pairs of cameras (S2)."""
