"""The cell, its arm, what the arm reaches and what it collides with."""
