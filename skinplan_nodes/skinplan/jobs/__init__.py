"""Jobs: ISA-95 states, checks, the store."""
