"""Mixed parts lying freely on a tray: the test bed of recognition and registration (R4.1)."""
