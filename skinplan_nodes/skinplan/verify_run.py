"""Verifies a run: starts ``skinplan_nodes.replay_verify`` as a program of its own."""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from skinplan.errors import InputError, SkinplanError
from skinplan.replay_run import require_nodes


def verify_run(
    bag: Path, part: Path | None = None, cell: Path | None = None, changes: Sequence[str] = ()
) -> dict[str, Any]:
    """Feeds the recorded inputs of a run to the real nodes again and compares their results.

    Args:
        bag: Bag of the run.
        part: Part file in the place of the recorded one; None = that.
        cell: Cell file; None = the default cell.
        changes: Parameters of nodes that differ, each ``node.parameter=value``.

    Returns:
        ``identical``, ``first_difference`` (name of a stage, or None) and ``stages``, each with
        ``name``, ``compared``, ``differences`` and ``notes``.

    Raises:
        InputError: The nodes are not installed, or the bag or a change can't be used.
        SkinplanError: The verification failed.
    """
    require_nodes()
    command = [sys.executable, "-P", "-m", "skinplan_nodes.replay_verify", str(bag.absolute())]
    command += ["--part", str(part.absolute())] if part else []
    command += ["--cell", str(cell.absolute())] if cell else []
    for change in changes:
        command += ["--set", change]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    try:
        document: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    except (json.JSONDecodeError, IndexError):
        raise SkinplanError(
            f"the verification ended with code {done.returncode}; its log above says why"
        ) from None
    if "error" in document:
        kind = InputError if document.get("code") == 2 else SkinplanError
        raise kind(document["error"])
    return document
