"""Feeds the recorded inputs of a run to the real nodes again and compares what they make of it."""
