"""Meshes: loading, checking and repairing, smoothing, curvature, complex regions."""
