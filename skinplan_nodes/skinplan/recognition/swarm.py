"""Where a part lies, by a particle swarm (R2.3 step 3; strategy `pso`).

Six parameters: where the middle of the part is, and its turns about three axes. A particle
stagnates when its mean distance hardly changes between two iterations; the share of particles that
do is the stagnation coefficient. When it is high, part of the swarm gets a larger range of the
inertia weight and random numbers are added. Near the optimum the parameters are moved one at a
time, toward the steepest decrease.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skinplan.errors import InputError
from skinplan.inspection.points import enough_points, evenly
from skinplan.recognition.fit_model import FitModel, outline_middle
from skinplan.recognition.part_cloud import PartCloud
from skinplan.recognition.planes import Plane
from skinplan.recognition.search import plane_frame
from skinplan.transforms import Array, apply, inverse, transform


@dataclass(frozen=True)
class SwarmSettings:
    """How the swarm flies.

    Attributes:
        particles: In the swarm.
        iterations: Of the swarm.
        points: Of the cloud that the distance is taken over.
        fine_points: The same for the fine moves.
        inertia: Range of the inertia weight.
        inertia_stagnant: The same for the part of the swarm that is to leave its place.
        pull: Toward a particle's own best and toward the swarm's best.
        stagnation_change: A relative change of the mean distance below this is stagnation [1].
        stagnation_coefficient: With a larger share of stagnating particles the swarm stagnates [1].
        enlarged_share: Part of the stagnating particles that get the larger inertia [1].
        spread_m: Start and random moves, position [m].
        spread_rad: Start and random moves, tilt.
        cut_m: A point counts no more than this [m].
        fine_starts: Best particles that are moved one parameter at a time ...
        fine_iterations: ... so often at most ...
        fine_m: ... with this step in the beginning [m].
    """

    particles: int = 48
    iterations: int = 90
    points: int = 100
    fine_points: int = 250
    inertia: tuple[float, float] = (0.5, 0.9)
    inertia_stagnant: tuple[float, float] = (0.8, 1.3)
    pull: tuple[float, float] = (1.4, 1.4)
    stagnation_change: float = 0.01
    stagnation_coefficient: float = 0.6
    enlarged_share: float = 0.5
    spread_m: float = 0.01
    spread_rad: float = 0.1
    cut_m: float = 0.05
    fine_starts: int = 3
    fine_iterations: int = 120
    fine_m: float = 0.004


@dataclass(frozen=True, eq=False)
class SwarmFit:
    """What the swarm found.

    Attributes:
        T_tray_part: shape (4, 4) [m].
        mean_distance_m: Of the cloud's points to the model, with the cut [m].
        stagnations: Iterations in which the swarm stagnated.
        evaluations: Poses tried.
    """

    T_tray_part: Array
    mean_distance_m: float
    stagnations: int
    evaluations: int


def swarm_fit(
    cloud: PartCloud,
    model: FitModel,
    plane: Plane,
    seed: int = 0,
    settings: SwarmSettings | None = None,
) -> SwarmFit:
    """Finds where the model lies; the same seed finds the same.

    Args:
        cloud: Of one part.
        model: The part that it is thought to be.
        plane: The tray.
        seed: Of the random numbers.
        settings: How.

    Returns:
        The best pose that any particle had.

    Raises:
        NoCloudError: Too few points.
        InputError: Points that are not finite, or settings that can't be used.
    """
    settings = settings or SwarmSettings()
    if settings.particles < 2 or settings.fine_starts < 1 or settings.iterations < 1:
        raise InputError(
            f"a swarm of {settings.particles} particles, {settings.iterations} iterations and "
            f"{settings.fine_starts} fine starts was asked for; 2, 1 and 1 or more are accepted"
        )
    enough_points(cloud.points)
    problem = _Problem(cloud, model, plane, settings)
    best, stagnations = _flown(problem, settings, np.random.default_rng(seed))
    place, value = _refined(problem, best, settings)
    return SwarmFit(problem.poses(place[None])[0], value, stagnations, problem.evaluations)


class _Problem:
    """Mean distance of the cloud to the model as a function of six parameters.

    Shift of the middle [m] from where the outline's middle is, turned about x, y, z.
    """

    def __init__(
        self, cloud: PartCloud, model: FitModel, plane: Plane, settings: SwarmSettings
    ) -> None:
        self.evaluations = 0
        self.size_m = model.size_m
        self._model, self._cut = model, settings.cut_m
        self._T_tray_plane = plane_frame(plane)
        flat = apply(inverse(self._T_tray_plane), cloud.points)
        x, y = outline_middle(flat)
        laid = next(iter(model.laid.values()))
        heights = apply(laid, model.mesh.vertices)[:, 2]
        low, high = float(heights.min()), float(heights.max())
        middle = (low + high) / 2.0
        self._T_middle_part = transform((0.0, 0.0, -middle)) @ laid
        self._origin = np.array([x, y, middle])
        self._few = flat[evenly(len(flat), settings.points)]
        self._many = flat[evenly(len(flat), settings.fine_points)]

    def mean_distance(self, places: Array, fine: bool = False) -> Array:
        """Of parameters of shape (p, 6), shape (p,) [m]."""
        points = self._many if fine else self._few
        turns = Rotation.from_euler("xyz", places[:, 3:]).as_matrix()
        offset = points[None] - (self._origin + places[:, :3])[:, None]
        local = np.einsum("pji,pnj->pni", turns, offset)
        back = inverse(self._T_middle_part)
        local = local @ back[:3, :3].T + back[:3, 3]
        away, _ = self._model.tree.query(local.reshape(-1, 3), distance_upper_bound=self._cut)
        self.evaluations += len(places)
        return np.asarray(np.minimum(away, self._cut).reshape(len(places), -1).mean(axis=1))

    def poses(self, places: Array) -> Array:
        """``T_tray_part`` of parameters of shape (p, 6), shape (p, 4, 4)."""
        turns = Rotation.from_euler("xyz", places[:, 3:]).as_matrix()
        return np.stack(
            [
                self._T_tray_plane @ transform(self._origin + place[:3], turn) @ self._T_middle_part
                for place, turn in zip(places, turns, strict=True)
            ]
        )


def _flown(
    problem: _Problem, settings: SwarmSettings, rng: np.random.Generator
) -> tuple[Array, int]:
    """Best places of the particles, the best first, shape (p, 6), and iterations of stagnation."""
    count = settings.particles
    spread = np.array([settings.spread_m] * 3 + [settings.spread_rad] * 3)
    place = _scattered(count, spread, rng)
    speed = 0.1 * spread * rng.standard_normal((count, 6))
    value = problem.mean_distance(place)
    own, own_value = place.copy(), value.copy()
    stagnations = 0
    for _ in range(settings.iterations):
        leader = own[int(np.argmin(own_value))]
        inertia = rng.uniform(*settings.inertia, (count, 1))
        before = value
        pulls = rng.random((2, count, 6)) * np.reshape(settings.pull, (2, 1, 1))
        speed = inertia * speed + pulls[0] * (own - place) + pulls[1] * (leader - place)
        place = place + speed
        value = problem.mean_distance(place)
        better = value < own_value
        own[better], own_value[better] = place[better], value[better]
        still = np.abs(value - before) < settings.stagnation_change * np.maximum(before, 1e-9)
        if np.mean(still) > settings.stagnation_coefficient:
            stagnations += 1
            place, speed, value = _stirred(problem, place, speed, value, still, settings, rng)
    return own[np.argsort(own_value, kind="stable")], stagnations


def _scattered(count: int, spread: Array, rng: np.random.Generator) -> Array:
    place = spread * rng.standard_normal((count, 6))
    # On either side, headings all around: one between two particles is as good as any other.
    place[:, 3] += np.pi * (np.arange(count) % 2)
    headings = (np.arange(count) // 2 + rng.random()) * 4.0 * np.pi / max(count, 2)
    place[:, 5] += headings
    return np.asarray(place)


def _stirred(
    problem: _Problem,
    place: Array,
    speed: Array,
    value: Array,
    still: NDArray[np.bool_],
    settings: SwarmSettings,
    rng: np.random.Generator,
) -> tuple[Array, Array, Array]:
    """Makes part of the stagnating particles leave: larger inertia, random numbers added."""
    chosen = np.flatnonzero(still & (rng.random(len(still)) < settings.enlarged_share))
    spread = np.array([settings.spread_m] * 3 + [settings.spread_rad] * 3)
    fresh = _scattered(len(chosen), spread, rng)
    inertia = rng.uniform(*settings.inertia_stagnant, (len(chosen), 1))
    place, speed, value = place.copy(), speed.copy(), value.copy()
    place[chosen] = fresh
    speed[chosen] = inertia * speed[chosen] + 0.1 * spread * rng.standard_normal((len(chosen), 6))
    value[chosen] = problem.mean_distance(place[chosen]) if len(chosen) else value[chosen]
    return place, speed, value


def _refined(problem: _Problem, best: Array, settings: SwarmSettings) -> tuple[Array, float]:
    """Moves single parameters toward the steepest decrease; returns the place and its value."""
    starts = _unlike(best, settings.fine_starts, problem.size_m)
    finished = [_descended(problem, start, settings) for start in starts]
    return min(finished, key=lambda each: each[1])


def _unlike(best: Array, count: int, size_m: float) -> list[Array]:
    """Best places that differ from each other."""
    kept: list[Array] = []
    for place in best:
        gaps = [place - other for other in kept]
        turned = [np.abs((gap[3:] + np.pi) % (2.0 * np.pi) - np.pi) for gap in gaps]
        if all(
            turn.max() > 0.2 or np.linalg.norm(gap[:3]) > 0.1 * size_m
            for turn, gap in zip(turned, gaps, strict=True)
        ):
            kept.append(place)
        if len(kept) == count:
            break
    return kept


def _descended(problem: _Problem, start: Array, settings: SwarmSettings) -> tuple[Array, float]:
    place = start.copy()
    step = settings.fine_m * np.array([1.0] * 3 + [2.0 / problem.size_m] * 3)
    value = float(problem.mean_distance(place[None], fine=True)[0])
    for _ in range(settings.fine_iterations):
        tried = np.concatenate([place + np.diag(step), place - np.diag(step)])
        found = problem.mean_distance(tried, fine=True)
        least = int(np.argmin(found))
        if found[least] < value:
            place, value = tried[least], float(found[least])
        else:
            step = step / 2.0
            if step[0] < 1e-6:
                break
    return place, value
