"""Differences between what was recorded and what came out now, item by item in words."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skinplan.transforms import difference
from skinplan_nodes.conversions import (
    pose_from_msg,
    scan_path_from_msg,
    station_plan_from_msg,
    station_trajectory_from_msg,
)

# Hashes count whole micrometres and microradians; so do these comparisons.
_LEAST = 1e-6
_LEAST_PX = 1e-4


@dataclass
class StageResult:
    """How one stage compares.

    Attributes:
        name: The stage.
        compared: Items that were compared.
        differences: One sentence per item that differs.
        notes: What could not be compared, with the reason.
    """

    name: str
    compared: int = 0
    differences: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def document(self) -> dict[str, Any]:
        """Returns it for JSON."""
        return {**vars(self), "identical": not self.differences}


def scan_path_differences(recorded: Any, found: Any) -> Iterator[str]:
    """Compares two ``skinplan_msgs/ScanPath``."""
    if found.plan_hash == recorded.plan_hash and recorded.plan_hash:
        return
    before, now = scan_path_from_msg(recorded), scan_path_from_msg(found)
    if before.strategy != now.strategy:
        yield f"scan path: strategy {before.strategy} was recorded, {now.strategy} found"
    if len(before) != len(now):
        yield f"scan path: {len(before)} points were recorded, {len(now)} found"
    count = min(len(before), len(now))
    apart = np.linalg.norm(before.positions[:count] - now.positions[:count], axis=1)
    turned = np.linalg.norm(before.directions[:count] - now.directions[:count], axis=1)
    for point in np.flatnonzero((apart > _LEAST) | (turned > _LEAST)):
        yield (
            f"scan path, point {point}: {apart[point] * 1e3:.3f} mm and {turned[point]:.2e} rad "
            "apart"
        )
    if recorded.mesh_sha256 != found.mesh_sha256:
        yield f"scan path: mesh {recorded.mesh_sha256} was recorded, {found.mesh_sha256} found"


def station_differences(recorded: Any, found: Any) -> Iterator[str]:
    """Compares two ``skinplan_msgs/StationPlan``."""
    before, now = station_plan_from_msg(recorded), station_plan_from_msg(found)
    if before.strategy != now.strategy:
        yield f"stations: strategy {before.strategy} was recorded, {now.strategy} found"
    if len(before.stations) != len(now.stations):
        yield f"stations: {len(before.stations)} were recorded, {len(now.stations)} found"
    for old, new in zip(before.stations, now.stations, strict=False):
        apart, turned = difference(old.T_map_base_link, new.T_map_base_link)
        if apart > _LEAST or turned > _LEAST:
            yield f"station {old.id}: {apart * 1e3:.3f} mm and {turned:.2e} rad apart"
        if list(old.points) != list(new.points):
            yield (
                f"station {old.id}: points {list(old.points)} were recorded, "
                f"{list(new.points)} found"
            )


def trajectory_differences(recorded: Any, found: Any) -> Iterator[str]:
    """Compares two ``skinplan_msgs/StationTrajectory``."""
    where = f"trajectory of station {recorded.station_id}"
    before, now = station_trajectory_from_msg(recorded), station_trajectory_from_msg(found)
    if len(before.segments) != len(now.segments):
        yield f"{where}: {len(before.segments)} segments were recorded, {len(now.segments)} found"
    skipped = sorted(s.point for s in before.skipped), sorted(s.point for s in now.skipped)
    if skipped[0] != skipped[1]:
        yield f"{where}: points {skipped[0]} were left out, now {skipped[1]}"
    for number, (old, new) in enumerate(zip(before.segments, now.segments, strict=False)):
        what = f"{where}, segment {number}"
        if old.kind != new.kind:
            yield f"{what}: scan and transit differ"
        elif old.positions.shape != new.positions.shape:
            yield f"{what}: {len(old.times)} times were recorded, {len(new.times)} found"
        elif (turned := float(np.abs(old.positions - new.positions).max(initial=0.0))) > _LEAST:
            yield f"{what}: joints up to {turned:.2e} rad apart"
        elif (late := float(np.abs(old.times - new.times).max(initial=0.0))) > _LEAST:
            yield f"{what}: times up to {late:.2e} s apart"


def observation_differences(recorded: Any, found: Any) -> Iterator[str]:
    """Compares two ``skinplan_msgs/MarkerObservations`` of one image."""
    stamp = recorded.header.stamp
    where = f"image of {stamp.sec}.{stamp.nanosec:09d} s"
    before = {item.id: item for item in recorded.observations}
    now = {item.id: item for item in found.observations}
    if sorted(before) != sorted(now):
        yield f"{where}: markers {sorted(before)} were recorded, {sorted(now)} found"
    for number in sorted(before.keys() & now.keys()):
        old, new = before[number], now[number]
        moved = float(np.abs(np.subtract(old.corners, new.corners)).max())
        apart, turned = difference(pose_from_msg(old.pose.pose), pose_from_msg(new.pose.pose))
        if moved > _LEAST_PX or apart > _LEAST or turned > _LEAST:
            yield (
                f"{where}, marker {number}: corners {moved:.4f} px, pose {apart * 1e3:.3f} mm and "
                f"{turned:.2e} rad apart"
            )
    for name in ("unknown_ids", "duplicate_ids", "mirrored_ids", "covered_ids"):
        old_ids, new_ids = list(getattr(recorded, name)), list(getattr(found, name))
        if old_ids != new_ids:
            yield f"{where}: {name} {old_ids} were recorded, {new_ids} found"


def part_pose_differences(recorded: Any, found: Any) -> Iterator[str]:
    """Compares two ``skinplan_msgs/PartPose``."""
    stamp = recorded.header.stamp
    where = f"part pose of {stamp.sec}.{stamp.nanosec:09d} s"
    old, new = pose_from_msg(recorded.pose.pose), pose_from_msg(found.pose.pose)
    apart, turned = difference(old, new)
    if apart > _LEAST or turned > _LEAST:
        yield f"{where}: {apart * 1e3:.3f} mm and {turned:.2e} rad apart"
    if abs(recorded.quality - found.quality) > _LEAST:
        yield f"{where}: quality {recorded.quality:.6f} was recorded, {found.quality:.6f} found"
    if list(recorded.marker_ids) != list(found.marker_ids):
        yield (
            f"{where}: markers {list(recorded.marker_ids)} were recorded, "
            f"{list(found.marker_ids)} found"
        )
