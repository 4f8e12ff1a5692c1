"""Devices that behave as their real counterparts, on simulated time (M4)."""
