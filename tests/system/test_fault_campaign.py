"""Every fault at every state: the run finishes, or ends as failed with a code; nothing is lost."""

import pytest

from system.fault_campaign import FAULTS, FULL_DISK, STATES, Case, run_cases


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault != FULL_DISK])
def test_jobs_survive_or_end_by_name(fault: str) -> None:
    cases = [Case(fault, state, 1) for state in STATES]
    found = list(run_cases(cases, 1, "16", "fault_campaign"))
    assert [row for row in found if not row.is_good] == []
