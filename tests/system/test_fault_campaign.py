"""Every fault at every state: the run finishes, or ends as failed with a code; nothing is lost."""

from pathlib import Path

import pytest

from system.fault_campaign import FAULTS, STATES, run_case


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_run_survives_or_ends_by_name(tmp_path: Path, fault: str, state: str) -> None:
    found = run_case(tmp_path, fault, state, seed=1)
    assert found.is_good, found
