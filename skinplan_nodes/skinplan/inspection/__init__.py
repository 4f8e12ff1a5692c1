"""Results of a run: merged cloud, alignment, coverage reached, deviation, report."""
