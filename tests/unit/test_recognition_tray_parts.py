"""Nine parts on a tray: closed bodies, put down without overlap, the same for the same seed."""

import numpy as np
import pytest
import trimesh

from skinplan.errors import InputError
from skinplan.recognition.tray.blocks import Hole
from skinplan.recognition.tray.layout import TRAY_SIZE_M, layout, tray_grid
from skinplan.recognition.tray.parts import MAKERS, TWINS, part_mesh
from skinplan.recognition.tray.sheets import Bend, folded_sheet


@pytest.mark.parametrize("name", MAKERS)
def test_parts_are_closed_bodies(name: str) -> None:
    mesh = part_mesh(name)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1
    assert mesh.volume > 0.0
    assert 0.05 < mesh.extents.max() <= 0.4
    # No cell was turned inside out by a bend, a hole or the forming.
    assert mesh.area_faces.min() > 1e-9
    assert np.array_equal(mesh.vertices, part_mesh(name).vertices)


def test_a_folded_sheet_has_the_volume_of_its_neutral_fibre() -> None:
    length, flat, thickness, bend = 0.1, 0.03, 0.002, Bend(0.006, np.pi / 2)
    mesh = folded_sheet(length, (flat, bend, flat), thickness)
    # An upward bend turns about a point on the upper side.
    neutral = 2 * flat + (bend.radius_m - thickness / 2) * np.pi / 2
    assert mesh.volume == pytest.approx(length * neutral * thickness, rel=0.002)


def test_a_hole_takes_the_volume_of_a_disc() -> None:
    whole, radius = folded_sheet(0.1, (0.08,), 0.002), 0.012
    pierced = folded_sheet(0.1, (0.08,), 0.002, [Hole(0.04, 0.03, radius)])
    polygon = 0.5 * 16 * np.sin(2 * np.pi / 16)
    assert whole.volume == pytest.approx(0.1 * 0.08 * 0.002)
    lost = (whole.volume - pierced.volume) / (0.002 * radius**2)
    # The corners of the opening are on the circle, at unequal angles: between a square's share
    # of a regular polygon and the disc.
    assert 0.98 * polygon < lost < np.pi


def test_two_parts_look_alike_from_above_and_two_are_mirror_twins() -> None:
    plate, skin = part_mesh("doubler"), part_mesh("curved_skin")
    np.testing.assert_allclose(plate.bounds[:, :2], skin.bounds[:, :2], atol=1e-9)
    assert skin.extents[2] > 4 * plate.extents[2]
    left, right = (part_mesh(name) for name in TWINS)
    np.testing.assert_allclose(right.vertices * [1, -1, 1], left.vertices)
    assert right.volume == pytest.approx(left.volume)


@pytest.mark.parametrize("seed", range(5))
def test_layouts_keep_parts_apart_and_on_the_tray(seed: int) -> None:
    parts = layout(seed)
    assert [part.name for part in parts] == list(MAKERS)
    for i, part in enumerate(parts):
        points = part.points
        assert points[:, 2].min() == pytest.approx(0.0, abs=1e-12)
        assert np.all(points[:, :2] >= 0.02) and np.all(
            points[:, :2] <= np.array(TRAY_SIZE_M) - 0.02
        )
        for other in parts[i + 1 :]:
            gap = np.linalg.norm(part.outline[:, None] - other.outline[None], axis=-1).min()
            assert gap >= 0.02
            assert not _inside(part.outline, other.outline).any()


def test_layouts_repeat_and_differ() -> None:
    first, again, other = layout(3), layout(3), layout(4)
    for a, b, c in zip(first, again, other, strict=True):
        assert np.array_equal(a.T_tray_part, b.T_tray_part)
        assert not np.allclose(a.T_tray_part, c.T_tray_part)


def test_a_part_may_lie_upside_down() -> None:
    part, other = layout(1, ["rib_left", "zee_clip"], upside_down=["rib_left"])
    assert part.upside_down and part.T_tray_part[2, 2] == pytest.approx(-1.0)
    assert not other.upside_down and other.T_tray_part[2, 2] == pytest.approx(1.0)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match="no place was found"):
        layout(0, ["formed_skin"] * 3, size_m=(0.4, 0.4))
    with pytest.raises(InputError, match="'wing'.*angle_clip"):
        layout(0, ["wing"])
    with pytest.raises(InputError, match="upside down"):
        layout(0, ["doubler"], upside_down=["zee_clip"])


def test_the_grid_is_one_closed_body() -> None:
    grid = tray_grid()
    assert isinstance(grid, trimesh.Trimesh) and grid.is_watertight
    np.testing.assert_allclose(grid.bounds, [[0, 0, -0.004], [*TRAY_SIZE_M, 0]], atol=1e-12)


def _inside(outline: np.ndarray, points: np.ndarray) -> np.ndarray:
    edges = np.roll(outline, -1, axis=0) - outline
    offset = points[:, None] - outline[None]
    return np.all(edges[:, 0] * offset[..., 1] - edges[:, 1] * offset[..., 0] > 0, axis=1)
