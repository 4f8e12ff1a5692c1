"""Where the fixture roughly holds what stands on it, before it is known which part it is."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from skinplan.jobs.model import Job
from skinplan.part.files import load_part
from skinplan.transforms import inverse
from skinplan_nodes.part_cache import part_path
from skinplan_nodes.supervisor.cell import Located
from skinplan_nodes.supervisor.control import StepError
from skinplan_nodes.supervisor.identification import RECOGNIZER, Identified

_NO_MARKER, _AMBIGUOUS, _QUALITY, _ALIGNMENT = 202, 204, 205, 902


def rough_place(
    localize: Callable[[Job], Located], job: Job, others: tuple[Path, ...]
) -> Located | Identified:
    """Finds roughly where the fixture holds the part, whichever of the parts it is.

    A part without markers is located by its own shape: where that does not lie there, one of the
    others may.

    Args:
        localize: Locates the part of a job, and raises `StepError`.
        job: The job.
        others: Part files of what else may stand there.

    Returns:
        Where the job's part would be, or that it is none of them.

    Raises:
        StepError: As the localisation; not when another part stands there.
    """
    try:
        return localize(job)
    except StepError as error:
        if error.code != _ALIGNMENT and (error.code != _AMBIGUOUS or error.node != RECOGNIZER):
            raise
        missed = error
    asked = load_part(part_path(job.part_uri))
    parts = [load_part(path) for path in others]
    for path, part in zip(others, parts, strict=True):
        try:
            found = localize(replace(job, part_uri=str(path), mesh_sha256=""))
        except StepError as error:
            if error.code not in (_ALIGNMENT, _AMBIGUOUS, _QUALITY, _NO_MARKER):
                raise
            continue
        held = part.fixture.T_workpiece_fixture @ inverse(asked.fixture.T_workpiece_fixture)
        return replace(
            found,
            T_arm_base_workpiece=found.T_arm_base_workpiece @ held,
            T_map_workpiece=found.T_map_workpiece @ held,
        )
    if missed.code == _AMBIGUOUS:
        raise missed
    names = (asked.id, *(part.id for part in parts))
    return Identified((False,) * len(names), names, 0.0, str(missed))
