"""How the supervisor locates parts without markers, and asks which one stands there."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nodes.shape_part import write_shape_part
from skinplan.jobs.model import Job
from skinplan.part.files import load_part, save_part
from skinplan.transforms import transform
from skinplan_nodes.supervisor.cell import Located
from skinplan_nodes.supervisor.control import StepError
from skinplan_nodes.supervisor.identification import RECOGNIZER, Identified
from skinplan_nodes.supervisor.rough_place import rough_place

_AMBIGUOUS, _NOT_SEEN, _ALIGNMENT = 204, 905, 902


class Fixture:
    """A fixture on which one part stands, or none that is known."""

    def __init__(self, stands: Any, code: int = _ALIGNMENT) -> None:
        self.stands, self.code, self.asked = stands, code, []

    def localize(self, job: Job) -> Located:
        self.asked.append(job.part_uri)
        if self.stands is None or job.part_uri != str(self.stands.source):
            raise StepError(self.code, "it does not lie there", RECOGNIZER)
        place = transform((0.4, 1.0, 0.2))
        return Located(place, place, 1.0, 1, 5.0)


@pytest.fixture
def parts(tmp_path: Path) -> list[Any]:
    """Two parts; the second one is held 0.1 m higher."""
    mine = write_shape_part(tmp_path / "mine", "mine")
    other = write_shape_part(tmp_path / "other", "other")
    held = replace(other.fixture, T_workpiece_fixture=transform((0.0, -0.1, 0.0)))
    save_part(replace(other, fixture=held), other.source)
    return [mine, load_part(other.source)]


def test_the_place_of_another_part_says_where_the_job_s_would_be(parts: list[Any]) -> None:
    mine, other = parts
    job = Job("j1", str(mine.source), mine.mesh_sha256)
    here = Fixture(mine)
    found = rough_place(here.localize, job, (other.source,))
    assert isinstance(found, Located) and here.asked == [str(mine.source)]
    there = rough_place(Fixture(other).localize, job, (other.source,))
    assert isinstance(there, Located)
    # Fixtures lie upon each other: T_base_mine = T_base_other T_other_fixture T_fixture_mine.
    np.testing.assert_allclose(there.T_arm_base_workpiece[:3, 3], [0.4, 0.9, 0.2])


def test_none_of_the_parts_is_unknown_and_other_failures_pass(parts: list[Any]) -> None:
    mine, other = parts
    job = Job("j1", str(mine.source))
    none = rough_place(Fixture(None).localize, job, (other.source,))
    assert isinstance(none, Identified) and none.names == ("mine", "other")
    with pytest.raises(StepError, match="for part mine, on the fixture is another one: it does n"):
        none.require()
    for code in (_AMBIGUOUS, _NOT_SEEN):
        with pytest.raises(StepError) as caught:
            rough_place(Fixture(None, code).localize, job, (other.source,))
        assert caught.value.code == code
