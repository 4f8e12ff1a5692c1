"""Plans of the sample scenes, each made once in a test session, whichever process asks first."""

import dataclasses
import fcntl
import hashlib
import pickle
from pathlib import Path

from skinplan.part.model import ScanSettings
from skinplan.part.samples import write_sample
from skinplan.pipeline import Plan, plan_part
from skinplan.robot.cell import CellConfig
from skinplan.trajectory.cycle import cycle_time
from skinplan.trajectory.plan import plan_trajectories

CELL = CellConfig()


class ScenePlans:
    """Makes plans and keeps them in a folder that all test processes of a session share.

    Without prediction and timed coverage: those hold rays, which can't be kept in files.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(exist_ok=True)

    def __call__(self, name: str, **strategies: str) -> Plan:
        """The plan of a scene with some of its settings changed.

        Neither path nor stations depend on the order of visit, so plans that differ in it only
        share both.
        """
        order = strategies.pop("order_strategy", None)
        plan = self._whole(name, strategies)
        if order in (None, plan.part.scan.order_strategy):
            return plan
        scan = dataclasses.replace(plan.part.scan, order_strategy=order)
        stations, mesh = plan.station_plan, plan.prepared.mesh
        found = plan_trajectories(plan.path, stations, plan.part.T_map_workpiece, mesh, scan, CELL)
        return dataclasses.replace(
            plan,
            part=dataclasses.replace(plan.part, scan=scan),
            trajectories=found,
            cycle=cycle_time(stations, found, CELL, scan, plan.path),
        )

    def _whole(self, name: str, strategies: dict[str, str]) -> Plan:
        changed = dataclasses.replace(ScanSettings(), **strategies)
        key = hashlib.sha256(repr(changed).encode()).hexdigest()[:16]
        file = self._folder / f"{name}-{key}.pickle"
        with file.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not file.exists():
                part = write_sample(name, self._folder / name / key)
                assert part.scan == ScanSettings(), "the key is of the changes to the defaults"
                part = dataclasses.replace(part, scan=changed)
                plan = dataclasses.replace(plan_part(part, CELL), prediction=None, timed=None)
                whole = file.with_suffix(".new")
                whole.write_bytes(pickle.dumps(plan))
                whole.rename(file)
            return pickle.loads(file.read_bytes())
