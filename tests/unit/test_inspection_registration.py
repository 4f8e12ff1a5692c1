"""Laying a measured part on its mesh: accuracy with dents and noise, honesty without shape."""

import numpy as np
import pytest
import trimesh

from meshes import grid, without
from scanned_part import T_TRACKER_WORKPIECE, dented, off_by, scanned
from skinplan.errors import AlignmentError, InputError, NoCloudError
from skinplan.inspection.border import Border, cloud_ends
from skinplan.inspection.closest import SurfaceIndex
from skinplan.inspection.measure import deviations
from skinplan.inspection.registration import RegistrationSettings, register
from skinplan.inspection.stable import holding, with_holding
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.samples import sample_panel
from skinplan.recognition.tray.parts import part_mesh
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import apply, difference, inverse, transform

# Radius, height: a dent of 60 mm diameter and a step.
DENTS = ((-0.12, 0.10, 0.030, -5e-4), (0.15, -0.10, 0.060, 3e-4))


def index_of(mesh):
    return SurfaceIndex(mesh, sample_surface(mesh))


def panel(name, cell=0.0035):
    shape = sample_panel(name)
    return grid(*shape.size_m, cell, shape.height)


def spread(mesh, count, seed=0, noise=3e-5):
    rng = np.random.default_rng(seed)
    face = rng.choice(len(mesh.faces), count, p=mesh.face_areas / mesh.area)
    points = np.einsum("nc,nci->ni", rng.dirichlet(np.ones(3), count), mesh.corners[face])
    return points + rng.normal(size=(count, 1)) * noise * mesh.face_normals[face]


def assert_found(mesh, seed, start, step_m=0.03):
    """The acceptance: pose within 0.02 mm and 0.005 degrees, dents within 0.02 mm."""
    cloud = scanned(dented(mesh, *DENTS), seed, step_m)
    index = index_of(mesh)
    found = register(cloud, index, T_TRACKER_WORKPIECE @ start)
    distance, angle = difference(T_TRACKER_WORKPIECE, found.T_tracker_workpiece)
    assert found.converged and found.undetermined == ()
    assert distance < 2e-5
    assert angle < np.deg2rad(0.005)
    assert found.position_sigma_m < 5e-5 and distance < 4.0 * found.position_sigma_m
    local = apply(inverse(found.T_tracker_workpiece), cloud)
    deviation = deviations(local, index)
    for x, y, radius, height in DENTS:
        # A cell of the mesh inside the wall.
        inside = np.hypot(local[:, 0] - x, local[:, 1] - y) < radius - 0.006
        assert np.nanmean(deviation[inside]) == pytest.approx(height, abs=2e-5)


def test_dents_and_misalignment_are_given_back_with_the_noise_of_the_devices():
    assert_found(panel("scene2"), 1, off_by(0.008, 0.5))


@pytest.mark.long
@pytest.mark.parametrize("name", ["scene1", "scene2", "scene3", "scene4"])
@pytest.mark.parametrize("seed", [2, 3])
def test_the_sample_panels_are_found_from_far(name, seed):
    # Frames as a scan at 10 Hz and 0.2 m/s takes them.
    assert_found(panel(name), seed, off_by(0.04, 1.0, seed), 0.02)


def test_a_flat_panel_is_found_by_its_border():
    mesh = grid(1.0, 0.6, 0.02)
    cloud = apply(T_TRACKER_WORKPIECE, spread(mesh, 300_000))
    found = register(cloud, index_of(mesh), T_TRACKER_WORKPIECE @ transform((0.04, 0.0, 0.0)))
    distance, angle = difference(T_TRACKER_WORKPIECE, found.T_tracker_workpiece)
    assert found.by_border and found.undetermined == ()
    assert distance < 2e-5 and angle < np.deg2rad(0.005)


def test_a_hole_tells_where_a_plate_without_edges_in_sight_lies():
    mesh = without(grid(1.0, 0.6, 0.005), lambda x, y: np.hypot(x - 0.1, y) < 0.06)
    points = spread(mesh, 300_000)
    points = points[np.all(np.abs(points[:, :2]) < [0.4, 0.2], axis=1)]
    found = register(points, index_of(mesh), transform((0.006, -0.005, 0.001)))
    # A round hole holds both shifts; the turn about the normal only by being no perfect circle.
    assert np.linalg.norm(found.T_tracker_workpiece[:2, 3]) < 2.5e-4
    assert found.by_border


def test_what_nothing_determines_is_kept_and_named():
    mesh = grid(1.0, 0.6, 0.02)
    points = spread(grid(0.8, 0.4, 0.02), 50_000)
    start = transform((0.004, -0.002, 0.003))
    found = register(points, index_of(mesh), start)
    assert found.T_tracker_workpiece[:2, 3] == pytest.approx([0.004, -0.002], abs=1e-6)
    assert found.T_tracker_workpiece[2, 3] == pytest.approx(0.0, abs=3e-6)
    shifts = [motion for motion in found.undetermined if not motion.turn.any()]
    turns = [motion for motion in found.undetermined if motion.turn.any()]
    assert len(shifts) == 2 and len(turns) == 1
    assert all(abs(motion.shift[2]) < 1e-3 for motion in shifts)
    assert turns[0].text == "turn about (0.00, 0.00, 1.00)"


def test_a_cylinder_slides_along_its_axis_only():
    radius = 0.5
    mesh = grid(0.8, 0.6, 0.01, lambda x, y: np.sqrt(radius**2 - y**2) - radius)
    points = spread(mesh, 60_000)
    points = points[np.all(np.abs(points[:, :2]) < [0.3, 0.2], axis=1)]
    start = transform((0.003, 0.002, 0.001))
    found = register(points, index_of(mesh), start)
    assert [motion.text for motion in found.undetermined] == ["shift along (1.00, 0.00, 0.00)"]
    assert found.T_tracker_workpiece[0, 3] == pytest.approx(0.003, abs=2e-5)
    assert found.T_tracker_workpiece[1, 3] == pytest.approx(0.0, abs=2e-5)


def test_a_missing_strip_is_not_taken_for_the_edge():
    mesh = grid(1.0, 0.6, 0.02)
    points = spread(mesh, 300_000)
    points = points[points[:, 0] < 0.47]
    found = register(points, index_of(mesh), off_by(0.002, 0.1))
    assert np.linalg.norm(found.T_tracker_workpiece[:3, 3]) < 1e-4


def test_the_error_is_as_large_as_the_stated_sigma():
    mesh = grid(1.0, 0.6, 0.02)
    index = index_of(mesh)
    ratios = []
    for seed in range(4):
        found = register(spread(mesh, 40_000, seed), index, off_by(0.003, 0.1, seed))
        error = np.linalg.norm(found.T_tracker_workpiece[:3, 3])
        ratios.append(error / found.position_sigma_m)
    assert 0.2 < np.sqrt(np.mean(np.square(ratios))) < 2.0


def test_the_result_turns_with_the_tracker_frame():
    mesh = panel("scene2", 0.01)
    points = spread(mesh, 20_000)
    start, move = off_by(0.004, 0.3), off_by(2.0, 100.0, 5)
    here = register(points, index_of(mesh), start)
    there = register(apply(move, points), index_of(mesh), move @ start)
    assert there.T_tracker_workpiece == pytest.approx(move @ here.T_tracker_workpiece, abs=1e-7)


def test_the_border_of_a_plate_with_a_hole():
    mesh = without(grid(0.4, 0.2, 0.01), lambda x, y: (np.abs(x) < 0.05) & (np.abs(y) < 0.03))
    border = Border(mesh)
    assert border.length_m == pytest.approx(2 * (0.4 + 0.2) + 2 * (0.10 + 0.06))
    rows = border.rows(np.array([[0.203, 0.01, 0.0], [0.047, 0.0, 0.0], [0.1, 0.06, 0.0]]), 0.006)
    assert rows.beyond == pytest.approx([0.003, 0.003], abs=1e-9)  # out, and into the hole
    assert rows.outward == pytest.approx(np.array([[1, 0, 0], [-1, 0, 0]]), abs=1e-9)


def test_the_ends_of_a_cloud_are_at_its_border():
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(-1, 1, 81), np.linspace(-0.5, 0.5, 41))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    points += rng.uniform(-0.008, 0.008, points.shape) * [1, 1, 0]
    ends = cloud_ends(points)
    inside = np.all(np.abs(points[:, :2]) < [0.95, 0.45], axis=1)
    assert ends[inside].mean() < 0.01
    outermost = np.any(np.abs(points[:, :2]) > [0.99, 0.49], axis=1)
    assert ends[outermost].mean() > 0.8


def test_what_can_t_be_laid_on_a_part_is_named():
    mesh = grid(0.3, 0.3, 0.02)
    index, points = index_of(mesh), spread(mesh, 500)
    with pytest.raises(NoCloudError, match="found 5"):
        register(points[:5], index, np.eye(4))
    with pytest.raises(AlignmentError, match="0 %"):
        register(points, index, transform((1.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="finite"):
        register(np.vstack([points, [[np.nan, 0, 0]]]), index, np.eye(4))
    with pytest.raises(InputError, match="coarse pose"):
        register(points, index, 2 * np.eye(4))


def section():
    """A hat stringer of 0.4 m along x, of sheet: closed, with ends as narrow as the sheet."""
    made = part_mesh("hat_stringer")
    return SurfaceMesh(np.asarray(made.vertices), np.asarray(made.faces, dtype=np.int64))


def section_cloud(mesh, seed, ends=10):
    """13,000 points of a section, those of its ends last: few, and every second one in mid-air."""
    rng = np.random.default_rng(seed)
    points = spread(mesh, 13_000, seed, 5e-6)
    length = mesh.bounds[1, 0]
    inside = np.minimum(points[:, 0], length - points[:, 0]) > 1e-4
    few = points[~inside][:ends]
    few[::2, 0] += rng.uniform(-1e-3, 1e-3, len(few[::2]))
    return np.concatenate([points[inside], few])


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_a_long_section_is_held_along_itself_by_few_points_at_its_ends(seed):
    mesh = section()
    settings = RegistrationSettings(points=3000, final_points=6000, gate_m=5e-4)
    start = transform((0.004, 0.0, 0.0))
    found = register(section_cloud(mesh, seed), index_of(mesh), start, settings)
    distance, _ = difference(np.eye(4), found.T_tracker_workpiece)
    assert found.undetermined == ()
    assert distance < 6e-6


def test_points_that_hold_a_motion_are_those_of_the_ends():
    mesh = section()
    cloud = section_cloud(mesh, 0, ends=40)
    even = np.arange(0, len(cloud), 7)
    held = holding(cloud, even, index_of(mesh))
    # The ends are the last points; beside an edge a normal may be that of the other face.
    assert np.isin(np.arange(len(cloud) - 40, len(cloud)), held).mean() > 0.85
    # The walls of its holes hold it, too; of the sheet itself nothing does.
    assert len(held) < 0.1 * len(cloud)
    numbers, counts = with_holding(even, held, len(cloud))
    assert len(np.unique(numbers)) == len(numbers)
    assert set(numbers.tolist()) == set(even.tolist()) | set(held.tolist())
    assert counts.sum() == pytest.approx(len(cloud))
    assert np.all(counts[np.isin(numbers, held)] == 1.0)


def test_nothing_is_added_where_every_motion_is_held_or_none_could_be():
    block = box_mesh(0.3, 0.2, 0.1)
    cloud = spread(block, 20_000)
    even = np.arange(0, len(cloud), 4)
    assert len(holding(cloud, even, index_of(block))) == 0
    plane = grid(1.0, 0.6, 0.02)
    assert len(holding(spread(plane, 20_000), even, index_of(plane))) == 0


def box_mesh(*size):
    made = trimesh.creation.box(size)
    return SurfaceMesh(np.asarray(made.vertices), np.asarray(made.faces, dtype=np.int64))
