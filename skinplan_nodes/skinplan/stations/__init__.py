"""Where the base stands (M2.3)."""
