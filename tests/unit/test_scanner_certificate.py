import dataclasses
import json

import numpy as np
import pytest
import trimesh

from meshes import bump, grid, joined, moved, random_transform, without
from skinplan.errors import InputError, ScanPathInvalidError
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.part.model import Fixture, Marker, ScanSettings
from skinplan.scan_path.model import ROW, ScanPath
from skinplan.scanner.certifier import Certifier
from skinplan.scanner.coverage import certify, visible
from skinplan.scanner.coverage_ply import write_coverage_ply
from skinplan.scanner.document import coverage_document
from skinplan.scanner.facet_states import facet_states, unseen_facets
from skinplan.scanner.facets import facet_codes
from skinplan.scanner.figures import all_figures, incidence_figures, sampling_error, whole_figures
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.obstacles import fixture_obstacle
from skinplan.scanner.predict import part_certifier, predict_coverage
from skinplan.scanner.sight import SIGHT_COLOURS, SIGHT_NAMES, Sight
from skinplan.transforms import apply, rotate, transform

SCANNER = ScannerModel(0.2, 0.2, 0.4, 0.3, np.radians(60))
DOWN = np.array([[0.0, 0.0, -1.0]])


def path_of(positions, directions=None):
    positions = np.asarray(positions, dtype=float)
    directions = np.repeat(DOWN, len(positions), axis=0) if directions is None else directions
    none = np.zeros(len(positions), dtype=np.int64)
    return ScanPath(
        positions, directions, positions + 0.3 * directions, none + ROW, none, "test", 0
    )


def plain(mesh):
    return Segmentation(np.zeros(len(mesh.faces), dtype=np.int64), mesh)


def in_disc(points, x, y, radius):
    return np.hypot(points[:, 0] - x, points[:, 1] - y) < radius


def stage():
    """A floor with what gives every reason: a wall, a roof, a lid of the fixture, a high table."""
    wall = moved(
        grid(0.1, 0.2, 0.02), transform((-0.6, 0.0, 0.05), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    )
    roof = moved(grid(0.1, 0.1, 0.02), transform((0.0, 0.0, 0.05)))
    table = moved(grid(0.1, 0.1, 0.02), transform((0.6, 0.0, 0.15)))
    mesh = joined(grid(2.0, 0.8, 0.02), wall, roof, table)
    lid = moved(grid(0.1, 0.1, 0.05), transform((0.0, 0.12, 0.03)))
    path = path_of([[-0.6, 0.0, 0.3], [0.0, 0.0, 0.3], [0.6, 0.0, 0.3]])
    return mesh, lid, path


def test_every_reason_where_it_belongs():
    mesh, lid, path = stage()
    found = certify(mesh, plain(mesh), path, SCANNER, occluders=(lid,), least_views=1)
    x, y, z = found.samples.points.T
    upright = np.abs(found.samples.normals[:, 2]) < 0.1
    wanted = np.full(len(x), Sight.NOT_REACHED)
    discs = [in_disc(found.samples.points, place, 0.0, 0.2) for place in (-0.6, 0.0, 0.6)]
    wanted[discs[0] | discs[1] | discs[2]] = Sight.SEEN_OFTEN
    low = z < 0.01
    wanted[low & (np.abs(x) < 0.05) & (np.abs(y) < 0.05)] = Sight.HIDDEN_BY_PART
    lidded = low & (np.abs(x) < 0.05) & (np.abs(y - 0.12) < 0.05) & discs[1]
    wanted[lidded] = Sight.HIDDEN_BY_FIXTURE
    wanted[(z > 0.14) & ~upright] = Sight.OUT_OF_RANGE
    wanted[low & (np.abs(x - 0.6) < 0.05) & (np.abs(y) < 0.05)] = Sight.HIDDEN_BY_PART
    # Of the upright wall the view sees the edge: nearer than d_min there is none of it.
    wanted[upright & discs[0]] = Sight.TOO_OBLIQUE
    np.testing.assert_array_equal(found.sights, wanted)
    assert set(wanted.tolist()) == set(Sight) - {Sight.SEEN, Sight.CANNOT_BE_SEEN}


def test_a_free_view_wins_over_all_and_the_first_that_hides_gives_the_reason():
    mesh, lid, path = stage()
    beside = np.array([[0.3, 0.0, 0.25]])
    lean = np.array([[-0.3, 0.0, -0.25]]) / np.hypot(0.3, 0.25)
    more = path_of(
        np.concatenate([path.positions, beside]), np.concatenate([path.directions, lean])
    )
    found = certify(mesh, plain(mesh), more, SCANNER, occluders=(lid,))
    first = certify(mesh, plain(mesh), path, SCANNER, occluders=(lid,))
    assert np.all((first.reasons == Sight.SEEN) <= (found.reasons == Sight.SEEN))
    under = (np.abs(found.samples.points[:, :2]).max(axis=1) < 0.05) & (
        found.samples.points[:, 2] < 0.01
    )
    assert 0.2 < np.mean(found.reasons[under] == Sight.SEEN) < 1.0
    assert set(found.reasons[under]) == {Sight.SEEN, Sight.HIDDEN_BY_PART}


def test_counts_of_views_make_seen_and_seen_often():
    mesh = grid(1.0, 0.4, 0.02)
    path = path_of([[-0.25, 0, 0.3], [-0.25, 0, 0.3], [0.25, 0, 0.3]])
    found = certify(mesh, plain(mesh), path, SCANNER, least_views=2)
    figures = whole_figures(found)
    disc = np.pi * 0.04
    assert figures.seen_ratio == pytest.approx(2 * disc / 0.4, rel=0.01)
    assert figures.often_seen_ratio == pytest.approx(disc / 0.4, rel=0.01)
    assert figures.areas_m2[Sight.SEEN] == pytest.approx(disc, rel=0.01)
    assert figures.areas_m2.sum() == pytest.approx(figures.area_m2)
    assert figures.area_m2 == pytest.approx(0.4)
    assert np.isnan(figures.seeable_ratio) and np.isnan(found.seeable_area_ratio)


def test_incidence_of_a_plane_against_axis_and_ray():
    lean = np.radians(25.0)
    direction = np.array([[np.sin(lean), 0.0, -np.cos(lean)]])
    mesh = grid(2.0, 2.0, 0.02)
    found = certify(mesh, plain(mesh), path_of(-0.3 * direction, direction), SCANNER, 0.004)
    figures = whole_figures(found)
    for value in (figures.axis.least_rad, figures.axis.median_rad, figures.axis.largest_rad):
        assert value == pytest.approx(lean)
    assert figures.axis.within_limit_ratio == 1.0
    # 25 degrees is the edge of two bins; rounding may put it on either side.
    assert figures.axis.shares[4:6].sum() == pytest.approx(1.0)
    # From straight above, the ray's angle at the distance a is atan(a / 0.3).
    straight = certify(mesh, plain(mesh), path_of([[0, 0, 0.3]]), SCANNER, 0.004)
    ray = whole_figures(straight).ray
    assert ray.largest_rad == pytest.approx(np.arctan(0.2 / 0.3), abs=0.01)
    assert ray.median_rad == pytest.approx(np.arctan(0.2 * np.sqrt(0.5) / 0.3), abs=0.005)
    assert ray.p95_rad == pytest.approx(np.arctan(0.2 * np.sqrt(0.95) / 0.3), abs=0.005)
    inner = (0.3 * np.tan(ray.edges_rad[1:])) ** 2 / 0.04
    np.testing.assert_allclose(np.cumsum(ray.shares), np.minimum(inner, 1.0), atol=0.01)
    tight = dataclasses.replace(SCANNER, incidence_max_rad=np.radians(20))
    limited = whole_figures(
        certify(mesh, plain(mesh), path_of([[0, 0, 0.3]]), tight, 0.004)
    ).ray.within_limit_ratio
    assert limited == pytest.approx((0.3 * np.tan(np.radians(20))) ** 2 / 0.04, abs=0.01)


def test_weights_count_in_the_distribution():
    figures = incidence_figures(
        np.array([0.1, 0.2, 0.3, np.nan]), np.array([1.0, 1.0, 8.0, 90.0]), 0.25
    )
    assert (figures.least_rad, figures.median_rad, figures.p95_rad) == (0.1, 0.3, 0.3)
    assert figures.within_limit_ratio == pytest.approx(0.2)
    assert figures.shares.sum() == pytest.approx(1.0)
    nothing = incidence_figures(np.array([np.nan]), np.ones(1), 1.0)
    assert np.isnan(nothing.median_rad) and np.isnan(nothing.shares).all()


def test_figures_of_each_region():
    mesh = grid(1.2, 0.4, 0.02)
    region = np.digitize(mesh.centroids[:, 0], [-0.2, 0.2])
    path = path_of([[0.0, 0.0, 0.3], [0.4, 0.0, 0.3]])
    figures = all_figures(certify(mesh, Segmentation(region, mesh), path, SCANNER))
    names = ["whole part", "flat surface", "complex regions", "region 1", "region 2"]
    assert [each.name for each in figures] == names
    disc = np.pi * 0.04
    for each, area, seen in zip(
        figures, [0.48, 0.16, 0.32, 0.16, 0.16], [2 * disc, 0, 2 * disc, disc, disc], strict=True
    ):
        assert each.area_m2 == pytest.approx(area, rel=0.01)
        assert each.seen_ratio * area == pytest.approx(seen, abs=0.002)
    assert np.isnan(figures[1].axis.median_rad)


def test_what_can_not_be_seen_at_all_is_told_apart():
    roof = moved(grid(0.5, 0.5, 0.02), transform((0.0, 0.0, 0.05)))
    mesh = joined(grid(1.0, 0.8, 0.02), roof)
    path = path_of([[-0.3, 0.0, 0.3], [0.3, 0.0, 0.3]])
    found = certify(mesh, plain(mesh), path, SCANNER, clearance_m=0.15)
    figures = whole_figures(found)
    low = found.samples.points[:, 2] < 0.01
    inner = low & (np.abs(found.samples.points[:, :2]).max(axis=1) < 0.25 - 0.05 * np.sqrt(3))
    assert np.all(found.sights[inner] == Sight.CANNOT_BE_SEEN)
    hidden = {Sight.HIDDEN_BY_PART, Sight.NOT_REACHED}
    assert set(found.reasons[found.sights == Sight.CANNOT_BE_SEEN]) == hidden
    assert found.can_be_seen[found.views > 0].all()
    share = 1 - np.mean(found.sights == Sight.CANNOT_BE_SEEN)
    assert found.seeable_area_ratio == figures.seeable_ratio == pytest.approx(share)
    assert found.area_ratio_of_seeable == pytest.approx(found.area_ratio / share)
    assert figures.seen_of_seeable_ratio == pytest.approx(found.area_ratio / share)
    assert np.isnan(found.feature_area_ratio_of_seeable)
    listed = unseen_facets(found)
    lost = listed.sights == Sight.CANNOT_BE_SEEN
    assert lost.any() and set(listed.reasons[lost]) <= hidden
    np.testing.assert_array_equal(listed.reasons[~lost], listed.sights[~lost])


def test_facets_agree_with_their_samples():
    mesh = grid(1.0, 0.6, 0.05, lambda x, y: bump(x, y, 0.09, 0.15, 0.05))
    path = path_of([[-0.2, 0.0, 0.3], [0.2, 0.1, 0.35]])
    found = certify(mesh, plain(mesh), path, SCANNER)
    states = facet_states(found)
    assert states.codes.shape == (len(mesh.faces),)
    assert len(states.names) == len(states.colours) == len(Sight)
    for face in range(0, len(mesh.faces), 7):
        own = found.sights[found.samples.faces == face]
        assert states.codes[face] == own.max()
    listed = unseen_facets(found)
    np.testing.assert_array_equal(listed.faces, np.flatnonzero(states.codes > Sight.SEEN))
    for face, ratio in list(zip(listed.faces, listed.seen_ratios, strict=True))[::11]:
        own = found.views[found.samples.faces == face]
        assert ratio == pytest.approx(np.mean(own > 0))
    assert 0 < len(listed.faces) < len(mesh.faces)


def test_small_facets_have_the_state_of_what_is_beside_them():
    fine = grid(0.6, 0.4, 0.0025)
    path = path_of([[0.0, 0.0, 0.3]])
    found = certify(fine, plain(fine), path, SCANNER, 0.005)
    seen = found.facet_sights <= Sight.SEEN
    radius = np.hypot(*fine.centroids[:, :2].T)
    assert len(np.unique(found.samples.faces)) < 0.2 * len(fine.faces)
    assert seen[radius < 0.19].all() and not seen[radius > 0.21].any()
    assert fine.face_areas[seen].sum() == pytest.approx(found.area_ratio * fine.area, rel=0.02)


def test_small_facets_of_thin_walls_take_the_side_that_they_are_on():
    front = grid(0.1, 0.1, 0.01)
    back = moved(front, transform((0.0, 0.0, -0.001), np.diag([1.0, -1.0, -1.0])))
    mesh = joined(front, back)
    owners = np.arange(0, len(mesh.faces), 5)
    codes = np.where(mesh.face_normals[owners, 2] > 0, 0, 3)
    found = facet_codes(mesh, mesh.centroids[owners], mesh.face_normals[owners], owners, codes)
    np.testing.assert_array_equal(found, np.where(mesh.face_normals[:, 2] > 0, 0, 3))
    none = np.zeros((0, 3))
    whole = np.zeros(0, dtype=np.int64)
    assert set(facet_codes(mesh, none, none, whole, whole)) == {-1}


def test_the_certificate_turns_with_the_part():
    mesh, lid, path = stage()
    T = random_transform(5)
    turned = path_of(apply(T, path.positions), rotate(T, path.directions))
    first = certify(mesh, plain(mesh), path, SCANNER, occluders=(lid,), clearance_m=0.1)
    part = moved(mesh, T)
    second = certify(
        part, plain(part), turned, SCANNER, occluders=(moved(lid, T),), clearance_m=0.1
    )
    assert np.mean(first.sights != second.sights) < 1e-3
    assert np.mean(first.facet_sights != second.facet_sights) < 5e-3
    np.testing.assert_allclose(
        whole_figures(first).areas_m2, whole_figures(second).areas_m2, atol=2e-3
    )
    seen = (first.views > 0) & (second.views > 0)
    np.testing.assert_allclose(first.ray_rad[seen], second.ray_rad[seen], atol=1e-9)


def test_the_certificate_does_not_depend_on_the_order_of_the_triangles():
    mesh, lid, path = stage()
    order = np.random.default_rng(2).permutation(len(mesh.faces))
    mixed = SurfaceMesh(mesh.vertices, mesh.faces[order])
    first = whole_figures(certify(mesh, plain(mesh), path, SCANNER, occluders=(lid,)))
    second = whole_figures(certify(mixed, plain(mixed), path, SCANNER, occluders=(lid,)))
    # Both are within the sampling error: about 4.5 m of boundary.
    np.testing.assert_allclose(first.areas_m2, second.areas_m2, atol=4.5 * 0.005)
    assert first.seen_ratio == pytest.approx(second.seen_ratio, abs=4.5 * 0.005 / mesh.area)


def test_the_stated_sampling_error_holds():
    mesh = grid(1.0, 0.8, 0.05)
    for x, y in np.random.default_rng(3).uniform(-0.15, 0.15, (5, 2)):
        found = certify(mesh, plain(mesh), path_of([[x, y, 0.3]]), SCANNER, 0.01)
        error = sampling_error(found)
        assert abs(found.area_ratio - np.pi * 0.04 / 0.8) <= error
        assert error <= 2 * np.pi * 0.2 * 0.02 / 0.8
    all_seen = certify(
        grid(0.1, 0.1, 0.05), plain(grid(0.1, 0.1, 0.05)), path_of([[0, 0, 0.3]]), SCANNER
    )
    assert sampling_error(all_seen) == pytest.approx(1 / len(all_seen.views))


def test_an_empty_path_sees_nothing():
    mesh = grid(0.3, 0.3, 0.05)
    found = certify(mesh, plain(mesh), path_of(np.zeros((0, 3))), SCANNER, clearance_m=0.1)
    assert found.area_ratio == 0.0 and found.area_ratio_of_seeable == 0.0
    assert found.seeable_area_ratio == 1.0
    assert set(found.sights) == {Sight.NOT_REACHED}
    assert set(found.facet_sights) == {Sight.NOT_REACHED}
    assert np.isnan(found.axis_rad).all()


def test_a_certifier_answers_like_single_certificates():
    mesh, lid, path = stage()
    certifier = Certifier(mesh, plain(mesh), SCANNER, occluders=(lid,), clearance_m=0.1)
    single = certify(mesh, plain(mesh), path, SCANNER, occluders=(lid,), clearance_m=0.1)
    for _ in range(2):
        again = certifier.points(path)
        np.testing.assert_array_equal(again.sights, single.sights)
        np.testing.assert_array_equal(again.views, single.views)
    counts = visible(certifier.samples, certifier.caster, path.positions, path.directions, SCANNER)
    np.testing.assert_array_equal(counts, single.views)


def test_the_document_is_plain_data():
    mesh, lid, path = stage()
    found = certify(mesh, plain(mesh), path, SCANNER, occluders=(lid,), clearance_m=0.1)
    document = coverage_document(found)
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    whole, flat, complexes = document["regions"]
    assert whole["seen_ratio"] == flat["seen_ratio"] == found.area_ratio
    assert complexes["seen_ratio"] is None and complexes["incidence_axis"]["median_rad"] is None
    assert complexes["incidence_ray"]["shares"] == [None] * 18
    assert sum(whole["area_by_state_m2"].values()) == pytest.approx(mesh.area)
    assert document["scanner"]["field"] == "cylinder" and document["least_views"] == 3
    assert document["samples"]["spacing_m"] == pytest.approx(0.005, rel=1e-3)
    listed = unseen_facets(found)
    groups = document["unseen_facets"]
    assert sorted(sum((group["faces"] for group in groups), [])) == listed.faces.tolist()
    for group in groups:
        codes = found.facet_sights[group["faces"]]
        assert {facet_states(found).names[code] for code in codes} == {group["state"]}
    assert "unseen_facets" not in coverage_document(found, with_facets=False)


def test_the_picture_file_is_read_back(tmp_path):
    mesh, lid, path = stage()
    found = certify(mesh, plain(mesh), path, SCANNER, occluders=(lid,))
    file = tmp_path / "coverage.ply"
    write_coverage_ply(file, mesh, found)
    again = trimesh.load(file, process=False)
    np.testing.assert_array_equal(again.faces, mesh.faces)
    np.testing.assert_allclose(again.vertices, mesh.vertices, atol=1e-6)
    states = facet_states(found)
    np.testing.assert_array_equal(
        np.asarray(again.visual.face_colors)[:, :3], states.colours[states.codes]
    )
    assert len(np.unique(states.codes)) >= 5
    header = file.read_bytes().split(b"end_header")[0].decode()
    for code, name in enumerate(states.names):
        assert f"comment sight {code} {name}" in header
    assert list(tmp_path.iterdir()) == [file]


def test_a_picture_file_that_can_not_be_written(tmp_path):
    mesh, _, path = stage()
    found = certify(mesh, plain(mesh), path, SCANNER, 0.02)
    with pytest.raises(InputError, match="can't be written"):
        write_coverage_ply(tmp_path / "none" / "coverage.ply", mesh, found)
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(InputError, match="can't be written"):
        write_coverage_ply(tmp_path / "folder.ply", mesh, found)
    assert [file.name for file in tmp_path.iterdir()] == ["folder.ply"]
    with pytest.raises(InputError, match="faces"):
        write_coverage_ply(tmp_path / "x.ply", grid(1.0, 1.0, 0.5), found)


def test_names_and_colours_are_told_apart():
    assert len(SIGHT_NAMES) == len(set(SIGHT_NAMES)) == len(Sight)
    colours = np.array(SIGHT_COLOURS, dtype=float)
    apart = np.linalg.norm(colours[:, None] - colours[None], axis=2)
    assert apart[np.triu_indices(len(colours), 1)].min() > 60


def test_marker_boards_stand_where_the_markers_are():
    T_workpiece_fixture = random_transform(4)
    markers = (
        Marker(3, 0.10, transform((0.2, 0.0, 0.0))),
        Marker(8, 0.06, transform((-0.2, 0.1, 0.0), [[0, 0, 1], [1, 0, 0], [0, 1, 0]])),
    )
    fixture = Fixture("DICT_5X5_100", T_workpiece_fixture, markers)
    boards = fixture_obstacle(fixture, thickness_m=0.004, border_ratio=0.25)
    solid = trimesh.Trimesh(boards.vertices, boards.faces, process=False)
    assert solid.is_watertight
    for number, (marker, body) in enumerate(
        zip(markers, (boards.vertices[:8], boards.vertices[8:]), strict=True)
    ):
        local = apply(np.linalg.inv(fixture.T_workpiece_marker(marker.id)), body)
        half = 0.75 * marker.size_m
        np.testing.assert_allclose(local.min(axis=0), [-half, -half, -0.004], atol=1e-12)
        np.testing.assert_allclose(local.max(axis=0), [half, half, 0.0], atol=1e-12)
        faces = boards.faces[12 * number : 12 * number + 12] - 8 * number
        volume = trimesh.Trimesh(body, faces, process=False).volume
        assert volume == pytest.approx(4 * half**2 * 0.004)
    for wrong in ({"thickness_m": 0.0}, {"thickness_m": np.nan}, {"border_ratio": -0.1}):
        with pytest.raises(InputError, match="accepted"):
            fixture_obstacle(fixture, **wrong)


def test_a_board_before_the_part_hides_it():
    mesh = grid(0.8, 0.6, 0.02)
    fixture = Fixture(
        "DICT_5X5_100", transform((0.0, 0.0, 0.05)), (Marker(0, 0.07, transform((0.05, 0.0, 0.0))),)
    )
    settings = ScanSettings(field_of_view="cylinder", least_views=1)
    path = path_of([[0.0, 0.0, 0.3]])
    found = part_certifier(mesh, plain(mesh), settings, fixture).points(path)
    # The white border makes 0.10 m of 0.07 m.
    hidden = whole_figures(found).areas_m2[Sight.HIDDEN_BY_FIXTURE]
    assert hidden == pytest.approx(0.01, rel=0.1)
    assert found.seeable_area_ratio == 1.0
    free = predict_coverage(mesh, plain(mesh), path, settings).figures
    less = predict_coverage(mesh, plain(mesh), path, settings, fixture).figures
    assert free.area_ratio - less.area_ratio == pytest.approx(hidden / mesh.area)


@pytest.mark.parametrize(
    "words",
    [
        ({"least_views": 0}, "at least 1"),
        ({"least_views": np.nan}, "at least 1"),
        ({"clearance_m": -1.0}, "clearance"),
        ({"clearance_m": np.nan}, "clearance"),
        ({"spacing_m": 0.0}, "spacing"),
        ({"spacing_m": np.nan}, "spacing"),
    ],
)
def test_figures_that_can_not_be_used(words):
    mesh = grid(0.3, 0.3, 0.05)
    with pytest.raises(InputError, match=words[1]):
        certify(mesh, plain(mesh), path_of([[0, 0, 0.3]]), SCANNER, **words[0])


def test_things_that_do_not_fit_together():
    mesh = grid(0.3, 0.3, 0.05)
    other = grid(0.3, 0.3, 0.1)
    path = path_of([[0, 0, 0.3]])
    with pytest.raises(InputError, match="segmentation"):
        certify(mesh, plain(other), path, SCANNER)
    with pytest.raises(InputError, match="both"):
        caster = Certifier(mesh, plain(mesh), SCANNER).caster
        certify(mesh, plain(mesh), path, SCANNER, caster=caster, occluders=(other,))
    broken = SurfaceMesh(other.vertices * np.nan, other.faces)
    with pytest.raises(InputError, match="finite"):
        certify(mesh, plain(mesh), path, SCANNER, occluders=(broken,))
    for directions in (DOWN * 2, DOWN * np.nan, np.zeros((2, 3))):
        with pytest.raises(ScanPathInvalidError, match="accepted"):
            certify(mesh, plain(mesh), dataclasses.replace(path, directions=directions), SCANNER)
    # An obstacle without faces is none.
    nothing = without(other, lambda x, y: x < 9)
    assert certify(mesh, plain(mesh), path, SCANNER, occluders=(nothing,)).area_ratio > 0.9
