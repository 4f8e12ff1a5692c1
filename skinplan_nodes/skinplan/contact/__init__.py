"""Contact measurement: stations, tracker and motions for an arm with touch probe and T-Mac (C)."""
