"""Parts on a small tray: database, registration, verdict, and the answers that name what is odd."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from skinplan.errors import InputError, NoCloudError, StrategyUnknownError
from skinplan.recognition.database import (
    RESTS,
    MatchSettings,
    ModelDatabase,
    build,
)
from skinplan.recognition.fit_model import FitModel, outline_middle
from skinplan.recognition.global_fit import global_fit
from skinplan.recognition.part_cloud import PartCloud
from skinplan.recognition.planes import Plane
from skinplan.recognition.search import costs, pairs, stepped
from skinplan.recognition.swarm import SwarmSettings, swarm_fit
from skinplan.recognition.tray.layout import PlacedPart, resting
from skinplan.recognition.tray.parts import MAKERS, TWINS, part_mesh
from skinplan.recognition.tray.render import model_views, render_database, rendered
from skinplan.recognition.tray.scan import coarse_scan, fine_scan, tray_scene
from skinplan.recognition.tray_answers import (
    ALIKE,
    KNOWN,
    OUTSIDE,
    OVERLAPPING,
    UNKNOWN,
    UNPLACED,
    TrayPart,
    TraySettings,
)
from skinplan.recognition.tray_recognizer import TrayRecognizer
from skinplan.recognition.twins import embedded, model_hash
from skinplan.recognition.verdict import AMBIGUOUS, FAILED, GOOD, judge
from skinplan.recognition.vfh import BINS
from skinplan.transforms import apply, difference, inverse, transform

SIZE_M = (0.48, 0.48)
TRAY = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 1.0, 0.0)
NAMES = ("angle_clip", "doubler", *TWINS)
HEADINGS = 3


@pytest.fixture(scope="module")
def models() -> dict[str, trimesh.Trimesh]:
    return {name: part_mesh(name) for name in NAMES}


@pytest.fixture(scope="module")
def database(models: dict[str, trimesh.Trimesh]) -> ModelDatabase:
    return render_database(models, HEADINGS)


@pytest.fixture(scope="module")
def recognizer(models: dict[str, trimesh.Trimesh], database: ModelDatabase) -> TrayRecognizer:
    return TrayRecognizer(models, database, TraySettings(size_m=SIZE_M))


def placed(
    name: str, x: float, y: float, heading: float = 0.7, turned: bool = False, up: float = 0.0
) -> PlacedPart:
    mesh = part_mesh(name)
    pose = transform((x, y, up)) @ resting(mesh, heading, turned)
    return PlacedPart(name, pose, mesh, turned)


def answers(recognizer: TrayRecognizer, *parts: PlacedPart) -> list[TrayPart]:
    """Scans and recognises a tray; answers in the order of the places, the largest first."""
    scene, rng = tray_scene(parts, SIZE_M), np.random.default_rng(5)
    coarse = np.concatenate([view.points for view in coarse_scan(scene, rng, size_m=SIZE_M)])
    contents = recognizer.contents(coarse)
    found = []
    for place in contents.places:
        views = fine_scan(scene, place.middle, place.radius_m + 0.01, rng)
        clouds, cameras = zip(*((view.points, view.seen_from) for view in views), strict=True)
        found.append(recognizer.part(clouds, cameras, contents.plane, place))
    return found


def off(part: PlacedPart, T_tray_part: np.ndarray) -> tuple[float, float]:
    """Distance [m] of the middle and angle [rad] from the truth."""
    middle = part.mesh.bounds.mean(axis=0)[None]
    moved = apply(T_tray_part, middle) - apply(part.T_tray_part, middle)
    return float(np.linalg.norm(moved)), difference(part.T_tray_part, T_tray_part)[1]


def test_parts_are_named_and_located(recognizer: TrayRecognizer) -> None:
    rib = placed("rib_right", 0.2, 0.13, 0.2)
    clip = placed("angle_clip", 0.2, 0.33, 2.0)
    plate = placed("doubler", 0.37, 0.33, 1.5, turned=True)
    found = {answer.name: answer for answer in answers(recognizer, rib, clip, plate)}
    assert set(found) == {"rib_right", "angle_clip", "doubler"}
    for part in (rib, clip, plate):
        answer = found[part.name]
        assert answer.answer == KNOWN, answer.reason
        assert answer.verdict is not None and answer.verdict.grade == GOOD
        assert answer.lies == RESTS[part.upside_down]
        assert answer.verdict.rmse_m < 3e-4
        away, turned = off(part, answer.T_tray_part)
        assert away < 2e-5 and turned < 1e-4
        assert answer.covariance is not None and np.linalg.eigvalsh(answer.covariance)[0] > -1e-15
    # The descriptor leaves the mirror twins open; their form does not.
    twin = found["rib_right"].match
    assert twin is not None and twin.name is None and set(twin.alike) == set(TWINS)
    assert "mirror twins" in twin.reason


def test_an_empty_tray_is_said_to_be_empty(recognizer: TrayRecognizer) -> None:
    scene = tray_scene([], SIZE_M)
    views = coarse_scan(scene, np.random.default_rng(0), size_m=SIZE_M)
    contents = recognizer.contents(np.concatenate([view.points for view in views]))
    assert contents.places == () and "empty tray" in contents.reason
    with pytest.raises(NoCloudError):
        recognizer.contents(np.zeros((0, 3)))


def test_a_high_flange_between_two_images_does_not_cut_a_part_in_two(
    recognizer: TrayRecognizer,
) -> None:
    # The upper flange, 43 mm over the tray, stands where two images of 0.45 m meet.
    size_m = (0.9, 0.45)
    scene, rng = tray_scene([placed("zee_clip", 0.44, 0.2, 4.7)], size_m), np.random.default_rng(0)
    views = coarse_scan(scene, rng, size_m=size_m)
    assert len(views) == 2
    contents = recognizer.contents(np.concatenate([view.points for view in views]))
    assert len(contents.places) == 1


def test_odd_parts_are_named(recognizer: TrayRecognizer) -> None:
    (unknown,) = answers(recognizer, placed("machined_bracket", 0.24, 0.24))
    assert unknown.answer == UNKNOWN and "nearest model" in unknown.reason
    assert unknown.T_tray_part is None
    plate = placed("doubler", 0.24, 0.24)
    clip = placed("angle_clip", 0.30, 0.27, 2.0, up=0.003)
    (both,) = answers(recognizer, plate, clip)
    assert both.answer == OVERLAPPING and both.name == "doubler", both.reason
    (outside,) = answers(recognizer, placed("doubler", 0.42, 0.24))
    assert outside.answer == OUTSIDE and "edge of the tray" in outside.reason


def test_a_part_with_an_odd_descriptor_is_named_by_its_form(
    models: dict[str, trimesh.Trimesh], database: ModelDatabase
) -> None:
    settings = TraySettings(size_m=SIZE_M, match=MatchSettings(distance_max=1e-6))
    strict = TrayRecognizer(models, database, settings)
    rib = placed("rib_left", 0.24, 0.24)
    (answer,) = answers(strict, rib)
    assert answer.match is not None and answer.match.name is None and answer.match.alike == ()
    assert answer.answer == KNOWN and answer.name == "rib_left", answer.reason
    away, turned = off(rib, answer.T_tray_part)
    assert away < 2e-5 and turned < 1e-4


def test_what_is_left_far_behind_changes_no_answer(
    models: dict[str, trimesh.Trimesh], database: ModelDatabase
) -> None:
    rib = placed("rib_right", 0.24, 0.24, 1.1)
    quick, thorough = (
        answers(
            TrayRecognizer(models, database, TraySettings(size_m=SIZE_M, beaten_ratio=ratio)), rib
        )[0]
        for ratio in (TraySettings().beaten_ratio, np.inf)
    )
    assert quick.name == thorough.name == "rib_right"
    assert quick.verdict == thorough.verdict and quick.reason == thorough.reason
    np.testing.assert_array_equal(quick.T_tray_part, thorough.T_tray_part)


@pytest.mark.parametrize("reach_m", [0.0005, 0.005, 0.02])
def test_points_out_of_reach_change_neither_costs_nor_steps(reach_m: float) -> None:
    part, cloud = lying("angle_clip", 0.3)
    model, rng = FitModel.of("angle_clip", part.mesh), np.random.default_rng(7)
    poses = np.repeat(inverse(part.T_tray_part)[None], 20, axis=0)
    poses[:, :3, 3] += rng.uniform(-0.03, 0.03, (20, 3))
    some = slice(None, None, 17)
    near, all_ = (
        pairs(model, cloud.points[some], cloud.normals[some], poses, reach)
        for reach in (reach_m, np.inf)
    )
    assert np.isinf(near.distance).mean() > 0.1 and np.isfinite(all_.distance).all()
    np.testing.assert_array_equal(costs(near, reach_m), costs(all_, reach_m))
    for any_side in (False, True):
        moved = stepped(near, poses, reach_m, any_side)
        np.testing.assert_allclose(moved, stepped(all_, poses, reach_m, any_side), atol=1e-12)


def test_parts_of_one_shape_are_not_guessed(models: dict[str, trimesh.Trimesh]) -> None:
    same = {"first": models["angle_clip"], "second": models["angle_clip"]}
    database = render_database(same, HEADINGS)
    assert database.twins == (("first", "second", "of the same shape"),)
    recognizer = TrayRecognizer(same, database, TraySettings(size_m=SIZE_M))
    (answer,) = answers(recognizer, placed("angle_clip", 0.2, 0.2))
    assert answer.answer == ALIKE and answer.name is None
    assert set(answer.alike) == {"first", "second"}


def test_the_database_is_read_back_as_it_was_written(
    database: ModelDatabase, models: dict[str, trimesh.Trimesh], tmp_path: Path
) -> None:
    assert database.twins == ((*TWINS, "mirror twins"),)
    assert len(database.descriptors) == len(NAMES) * len(RESTS) * HEADINGS
    path = tmp_path / "models.npz"
    database.save(path)
    again = ModelDatabase.load(path)
    assert (again.names, again.hashes, again.twins) == (
        database.names,
        database.hashes,
        database.twins,
    )
    np.testing.assert_array_equal(again.descriptors, database.descriptors)
    np.testing.assert_array_equal(again.model, database.model)
    again.check(models)
    assert list(tmp_path.iterdir()) == [path]


def test_a_database_of_other_models_is_refused(
    database: ModelDatabase, models: dict[str, trimesh.Trimesh], tmp_path: Path
) -> None:
    other = dict(models)
    other["doubler"] = models["angle_clip"]
    with pytest.raises(InputError, match="another shape of doubler"):
        database.check(other)
    with pytest.raises(InputError, match="none of wing"):
        database.check({"wing": models["doubler"]})
    moved = models["doubler"].copy()
    assert model_hash(moved) == model_hash(models["doubler"])
    moved.vertices = np.asarray(moved.vertices) + [2e-6, 0, 0]
    assert model_hash(moved) != model_hash(models["doubler"])
    path = tmp_path / "models.npz"
    with pytest.raises(InputError, match="found no file"):
        ModelDatabase.load(path)
    path.write_bytes(b"no archive")
    with pytest.raises(InputError, match="a database of models is accepted"):
        ModelDatabase.load(path)
    replace(database, rest=database.rest[:-1]).save(path)
    with pytest.raises(InputError, match="do not fit each other"):
        ModelDatabase.load(path)
    with pytest.raises(StrategyUnknownError, match="global, pso"):
        TrayRecognizer(models, database, TraySettings(registration="icp"))


def test_matches_are_those_of_brute_force(database: ModelDatabase) -> None:
    rng = np.random.default_rng(0)
    for view in rng.choice(len(database.model), 6, replace=False):
        wanted = database.descriptors[view] + rng.uniform(0, 0.5, BINS)
        away = np.linalg.norm(embedded(database.descriptors) - embedded(wanted), axis=1)
        match = database.match(wanted, MatchSettings(distance_max=1.0))
        assert match.distance == pytest.approx(away.min())
        for k, name in enumerate(database.names):
            assert match.distances[name] == pytest.approx(away[database.model == k].min())
        unknown = database.match(wanted, MatchSettings(distance_max=1e-6))
        assert unknown.name is None and unknown.alike == ()
        known = (match.name,) if match.name is not None else match.alike
        assert database.alike(unknown.distances, MatchSettings()) == known
    with pytest.raises(InputError, match=r"shape \(308,\)"):
        database.match(np.zeros(5))
    with pytest.raises(InputError, match="at least one view"):
        build({}, [])
    with pytest.raises(InputError, match="'wing'"):
        build({"doubler": part_mesh("doubler")}, [("wing", RESTS[0], np.zeros(BINS))])


@pytest.mark.parametrize("name", ["angle_clip", pytest.param("doubler", marks=pytest.mark.long)])
def test_swarm_and_global_find_a_clean_cloud(name: str) -> None:
    part, cloud = lying(name, 1.3)
    model = FitModel.of(name, part.mesh)
    fit = global_fit(cloud, model, TRAY)
    away, turned = off(part, fit.T_tray_part)
    assert away < 5e-6 and turned < 5e-5
    assert fit.other_cost_m > 2.0 * fit.cost_m
    first, again = (swarm_fit(cloud, model, TRAY, seed=4) for _ in range(2))
    np.testing.assert_array_equal(first.T_tray_part, again.T_tray_part)
    assert first.evaluations > 4000
    verdict = judge(cloud, model, first.T_tray_part)
    assert verdict.rmse_m < 0.0014
    other = swarm_fit(cloud, model, TRAY, seed=5)
    assert not np.array_equal(other.T_tray_part, first.T_tray_part)


def test_global_turns_with_the_tray() -> None:
    part, cloud = lying("zee_clip", 0.4)
    T_new_tray = transform((0.3, -0.2, 1.5), [0.1, 0.25, -0.3, 0.9])
    moved = PartCloud(
        apply(T_new_tray, cloud.points),
        cloud.normals @ T_new_tray[:3, :3].T,
        apply(T_new_tray, cloud.seen_from),
        apply(T_new_tray, cloud.above[None])[0],
    )
    normal = T_new_tray[:3, 2]
    plane = Plane(normal, float(normal @ T_new_tray[:3, 3]), 1.0, 0.0)
    fit = global_fit(moved, FitModel.of("zee_clip", part.mesh), plane)
    away, turned = off(part, inverse(T_new_tray) @ fit.T_tray_part)
    assert away < 5e-6 and turned < 5e-5


def test_a_wrong_model_fails_and_a_symmetric_one_is_ambiguous() -> None:
    _, cloud = lying("zee_clip", 0.4)
    wrong = FitModel.of("angle_clip", part_mesh("angle_clip"))
    fit = global_fit(cloud, wrong, TRAY)
    verdict = judge(cloud, wrong, fit.T_tray_part, (fit.cost_m, fit.other_cost_m), fit.alignment)
    assert verdict.grade == FAILED and "accepted" in verdict.reason
    block = trimesh.creation.box((0.12, 0.06, 0.02))
    lies = rendered(block, 0.5, False)
    model = FitModel.of("block", block)
    fit = global_fit(lies, model, TRAY)
    verdict = judge(lies, model, fit.T_tray_part, (fit.cost_m, fit.other_cost_m), fit.alignment)
    assert verdict.grade == AMBIGUOUS and "another pose" in verdict.reason


def test_settings_of_the_swarm_are_checked() -> None:
    part, cloud = lying("angle_clip", 0.0)
    with pytest.raises(InputError, match="1 particles"):
        swarm_fit(cloud, FitModel.of("a", part.mesh), TRAY, 0, SwarmSettings(particles=1))


def test_the_middle_of_an_outline_does_not_hang_on_density() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 0.1, (60_000, 3))
    crowded = np.concatenate([points, rng.uniform(0, 0.02, (60_000, 3))])
    np.testing.assert_allclose(outline_middle(points), 0.05, atol=0.003)
    np.testing.assert_allclose(outline_middle(crowded), outline_middle(points), atol=1e-4)


def test_views_are_rendered_in_both_rests() -> None:
    found = list(model_views({"angle_clip": part_mesh("angle_clip")}, headings=1))
    assert [(name, rest) for name, rest, _ in found] == [("angle_clip", rest) for rest in RESTS]
    assert not np.allclose(found[0][2], found[1][2])


@pytest.mark.long
def test_all_nine_parts_are_known_by_their_descriptors_at_other_headings() -> None:
    everything = {name: part_mesh(name) for name in MAKERS}
    database = render_database(everything)
    for name, mesh in everything.items():
        for turned in (False, True):
            match = database.match(rendered(mesh, 0.41, turned).descriptor())
            assert match.name == name or name in match.alike, match.reason
            assert match.name is not None or set(match.alike) == set(TWINS)


def lying(name: str, heading: float) -> tuple[PlacedPart, PartCloud]:
    """A part alone at the tray's origin, and its cloud without noise."""
    mesh = part_mesh(name)
    part = PlacedPart(name, resting(mesh, heading, False), mesh)
    return part, rendered(mesh, heading, False)


def test_a_part_that_vanishes_before_the_fine_scan_is_not_located(
    recognizer: TrayRecognizer,
) -> None:
    scene, rng = tray_scene([placed("angle_clip", 0.2, 0.2)], SIZE_M), np.random.default_rng(0)
    coarse = np.concatenate([view.points for view in coarse_scan(scene, rng, size_m=SIZE_M)])
    contents = recognizer.contents(coarse)
    (view, *_) = fine_scan(tray_scene([], SIZE_M), contents.places[0].middle, 0.1, rng)
    found = recognizer.part([view.points], [view.seen_from], contents.plane, contents.places[0])
    assert found.answer == UNPLACED and "points over the tray" in found.reason
