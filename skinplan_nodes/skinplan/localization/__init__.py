"""Where the part is, seen by its markers (M1.1, M1.2)."""
