"""Which part a cloud shows."""
