"""Readers of mesh files: bytes in, `RawMesh` in the file's own unit out."""
