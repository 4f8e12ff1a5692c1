"""How the arm moves (M2.4): order of visit, IK branches, timing, transitions."""
