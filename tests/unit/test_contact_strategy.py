import dataclasses

import numpy as np
import pytest

from reach_scene import flat_panel, flat_path, upright
from skinplan.contact.strategy import SETTINGS, axial_directions, axial_radial
from skinplan.errors import CancelledError, ScanPathInvalidError
from skinplan.mesh.prepare import prepare_mesh
from skinplan.part.inspection_points import InspectionPoints
from skinplan.part.model import ScanSettings
from skinplan.part.samples import write_sample
from skinplan.robot.cell import CellConfig, load_cell
from skinplan.scan_path.plan import plan_scan_path
from skinplan.stations.problem import StationProblem
from skinplan.transforms import inverse, planar


def problem(length, height, turn=0.0, **changes):
    made = StationProblem(
        flat_path(length, height, 0.16),
        upright(height, turn),
        flat_panel(length, height),
        ScanSettings(),
        CellConfig(),
    )
    return dataclasses.replace(made, **changes)


def test_a_small_panel_needs_one_station_in_front_of_it():
    proposal = axial_radial(problem(0.7, 0.6))
    assert len(proposal.poses) == 1 and len(proposal.uncovered) == 0
    x, y = proposal.poses[0][:2, 3]
    assert x == pytest.approx(0.0, abs=1e-9)
    assert -1.3 < y < -0.5
    # The part is on the left of the base.
    assert proposal.poses[0][:2, 1] == pytest.approx((0.0, 1.0), abs=1e-9)
    assert proposal.lower_bound == 0 and not proposal.proven_optimal


def test_stations_of_a_long_panel_are_evenly_along_it():
    proposal = axial_radial(problem(2.6, 0.6))
    along = np.array([pose[:2, 3] @ proposal.along for pose in proposal.poses])
    assert len(along) >= 2 and len(proposal.uncovered) == 0
    assert np.all(np.diff(along) > 0.0)
    count = len(along)
    assert along == pytest.approx([2.6 * ((2 * i + 1) / (2 * count) - 0.5) for i in range(count)])


def test_turning_the_shop_turns_the_stations():
    here, there = axial_radial(problem(0.7, 0.6)), axial_radial(problem(0.7, 0.6, 0.9))
    back = inverse(planar(0.0, 0.0, 0.9)) @ there.poses[0]
    assert np.allclose(back, here.poses[0], atol=1e-6)


@pytest.mark.parametrize("turn", np.linspace(-3.0, 3.0, 7))
def test_radial_is_away_from_what_is_seen_and_the_axis_along_the_points(turn):
    c, s = np.cos(turn), np.sin(turn)
    line = np.linspace(-1.0, 1.0, 20)[:, None] * (c, s)
    views = np.tile([-s, c, -0.3], (20, 1)) / np.hypot(1.0, 0.3)
    axes = axial_directions(line, views)
    assert axes[:, 0] == pytest.approx((s, -c))
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert abs(axes[:, 1] @ (c, s)) == pytest.approx(1.0)


def test_directions_without_a_clear_axis_or_view_are_still_a_frame():
    down = np.tile([0.0, 0.0, -1.0], (3, 1))
    ahead = np.tile([0.0, 1.0, 0.0], (3, 1))
    for positions in (np.zeros((3, 2)), np.array([[0.0, -1.0], [0.0, 0.0], [0.0, 1.0]])):
        for views in (down, ahead):
            axes = axial_directions(positions, views)
            assert np.allclose(axes.T @ axes, np.eye(2))
    assert axial_directions(np.zeros((3, 2)), ahead)[:, 0] == pytest.approx((0.0, -1.0))


def test_the_engine_gets_stations_along_it_with_the_engine_on_their_left(tmp_path):
    """C's part and arm, scanned: every fifth point, the example's cell."""
    part = write_sample("engine", tmp_path, triangles=4_000)
    prepared = prepare_mesh(part)
    few = InspectionPoints(
        part.points.targets[::5], part.points.normals[::5], part.points.groups[::5]
    )
    path = plan_scan_path(prepared.mesh, prepared.segmentation, part.scan, few)
    figures = dataclasses.replace(SETTINGS, stations_max=2)
    proposal = axial_radial(
        StationProblem(
            path, part.T_map_workpiece, prepared.mesh, part.scan, load_cell(tmp_path / "cell.yaml")
        ),
        figures,
    )
    assert 1 <= len(proposal.poses) <= 2
    assert abs(proposal.along[0]) == pytest.approx(1.0, abs=1e-2)
    for pose in proposal.poses:
        assert -1.6 < pose[1, 3] < -0.5 and abs(pose[0, 3]) < 1.3
        assert pose[:2, 1] == pytest.approx((0.0, 1.0), abs=0.05)
    # What is not reached looks down: the scanner would have to go below the engine.
    down = part.T_map_workpiece[:3, :3] @ path.directions[proposal.uncovered].T
    assert len(proposal.uncovered) < 0.5 * len(path)
    assert np.all(down[2] > 0.0)


def test_a_path_without_points_and_a_cancelled_search_are_errors():
    path = flat_path(0.7, 0.6, 0.3)
    empty = dataclasses.replace(
        path,
        **{
            name: getattr(path, name)[:0]
            for name in ("positions", "directions", "targets", "kinds", "groups")
        },
    )
    with pytest.raises(ScanPathInvalidError, match="without points"):
        axial_radial(problem(0.7, 0.6, path=empty))
    with pytest.raises(CancelledError):
        axial_radial(problem(0.7, 0.6, is_cancelled=lambda: True))
