"""Points sighted in images to structure and orientation (S2, S4)."""
