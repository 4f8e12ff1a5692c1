"""The steps of the mesh doctor; `skinplan.mesh.check` puts them together.

A step takes a `Patient` and a list that it adds its findings to, and returns the patient as it is
afterwards: the same object when nothing was to be repaired.
"""
