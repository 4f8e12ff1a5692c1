"""The parts of the cell supervisor: what it watches, what it writes, and the steps of a job."""
