"""Scan paths: row cutting, sampling of features, spacing law, offset."""
