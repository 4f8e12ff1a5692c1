"""What lies on the tray, which parts it is, and where: the whole chain (R2.2, R2.3).

Nothing is guessed: what is unknown, alike, overlapping or half outside is named.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import trimesh

from skinplan.errors import NoCloudError
from skinplan.inspection.points import checked_points, evenly
from skinplan.recognition.database import RESTS, Match, MatchSettings, ModelDatabase
from skinplan.recognition.fit_model import FitModel
from skinplan.recognition.global_fit import Fit, GlobalSettings, global_fit
from skinplan.recognition.part_cloud import CutSettings, PartCloud, Place, part_cloud, places
from skinplan.recognition.planes import Plane, find_plane
from skinplan.recognition.swarm import SwarmSettings, swarm_fit
from skinplan.recognition.verdict import FAILED, GOOD, Verdict, VerdictSettings, judge
from skinplan.strategies import chosen
from skinplan.transforms import Array, apply, inverse

REGISTRATIONS = ("global", "pso")

KNOWN = "known part"
ALIKE = "alike parts"
UNKNOWN = "unknown part"
OVERLAPPING = "overlapping parts"
OUTSIDE = "part half outside"
UNPLACED = "part not located"


@dataclass(frozen=True)
class TraySettings:
    """How parts on the tray are recognised.

    Attributes:
        registration: `global` or `pso`.
        size_m: Of the tray; its corner is the origin of the clouds' frame [m].
        edge_m: What comes this near to the tray's edge is half outside [m].
        alike_ratio: Of several candidates, one whose residual is this many times less than that of
            the others is the part [1].
        alike_m: Residuals below this can't be told apart [m].
        complete_hidden_min: A part below another one shows at least this share of itself [1].
        on_part_hidden_min: At least this share of the points lies on one of overlapping parts [1].
        hidden_grid: So many places to a side are tried for a part below another one.
        seed: Of all random numbers.
        cut: How parts are cut out of clouds.
        match: When a descriptor belongs to a model.
        search: Of `global`.
        swarm: Of `pso`.
        verdict: What makes a registration good.
    """

    registration: str = "global"
    size_m: tuple[float, float] = (1.8, 0.9)
    edge_m: float = 0.003
    alike_ratio: float = 2.0
    alike_m: float = 1e-4
    complete_hidden_min: float = 0.5
    on_part_hidden_min: float = 0.3
    hidden_grid: int = 4
    seed: int = 0
    cut: CutSettings = field(default_factory=CutSettings)
    match: MatchSettings = field(default_factory=MatchSettings)
    search: GlobalSettings = field(default_factory=GlobalSettings)
    swarm: SwarmSettings = field(default_factory=SwarmSettings)
    verdict: VerdictSettings = field(default_factory=VerdictSettings)


@dataclass(frozen=True, eq=False)
class Located:
    """One candidate laid on the cloud."""

    name: str
    fit: Fit
    verdict: Verdict


@dataclass(frozen=True, eq=False)
class TrayPart:
    """What lies at one place.

    Attributes:
        answer: `KNOWN`, `ALIKE`, `UNKNOWN`, `OVERLAPPING`, `OUTSIDE` or `UNPLACED`.
        name: The part; None = not known.
        alike: Parts that it may be, when it can't be told.
        lies: `upright` or `upside down`; empty when not known.
        T_tray_part: shape (4, 4) [m]; None = not known.
        covariance: Of the pose, rotation vector [rad] and position [m] about the middle of the
            cloud, part frame, shape (6, 6); None = not known.
        verdict: Of the registration; None = none was made.
        match: What the descriptor said; None = it was not asked.
        reason: The answer as a sentence.
    """

    answer: str
    name: str | None = None
    alike: tuple[str, ...] = ()
    lies: str = ""
    T_tray_part: Array | None = None
    covariance: Array | None = None
    verdict: Verdict | None = None
    match: Match | None = None
    reason: str = ""


@dataclass(frozen=True, eq=False)
class TrayContents:
    """What the coarse scan shows.

    Attributes:
        plane: The tray.
        places: Where something lies, the largest first.
        reason: In a sentence: `empty tray`, or how many places.
    """

    plane: Plane
    places: tuple[Place, ...]
    reason: str


class TrayRecognizer:
    """Recognises and locates the parts on a tray.

    Args:
        models: Parts by name [m].
        database: Built of these models.
        settings: How.

    Raises:
        InputError: The database was built of others, or the registration is unknown.
    """

    def __init__(
        self,
        models: Mapping[str, trimesh.Trimesh],
        database: ModelDatabase,
        settings: TraySettings | None = None,
    ) -> None:
        self._settings = settings or TraySettings()
        chosen("registration", self._settings.registration, dict.fromkeys(REGISTRATIONS, ""))
        database.check(models)
        self._database = database
        self._models = {name: FitModel.of(name, mesh).prepare() for name, mesh in models.items()}

    def contents(self, points: Array) -> TrayContents:
        """Finds the tray and what lies on it.

        Args:
            points: Coarse scan, frame of the tray with z up, shape (n, 3) [m].

        Raises:
            NoCloudError: Too few points.
            InputError: Points that are not finite, or no plane among them.
        """
        cloud = checked_points(points)
        above = np.array([*np.array(self._settings.size_m) / 2.0, 10.0])
        plane = find_plane(cloud, above, self._settings.seed)
        found = tuple(places(cloud, plane, self._settings.cut))
        if not found:
            return TrayContents(plane, (), "empty tray: nothing stands out of its plane")
        return TrayContents(plane, found, f"something lies at {len(found)} places")

    def part(
        self, clouds: Sequence[Array], cameras: Sequence[Array], plane: Plane, place: Place
    ) -> TrayPart:
        """Says which part lies at a place, and how.

        Args:
            clouds: Views of the fine scan, shapes (n, 3) [m]; the first looks straight down.
            cameras: Where they were taken from, shapes (3,) [m].
            plane: The tray.
            place: Where something lies.

        Returns:
            The answer; a part that is not known is no error.

        Raises:
            InputError: Points that are not finite.
        """
        if self._is_outside(place.points):
            return TrayPart(
                OUTSIDE,
                reason=f"a part at {_text(place)} reaches the edge of the tray and may lie half "
                "outside",
            )
        try:
            cloud = part_cloud(clouds, cameras, plane, place, self._settings.cut)
        except NoCloudError as error:
            return TrayPart(UNPLACED, reason=str(error))
        match = self._database.match(cloud.descriptor(self._settings.cut), self._settings.match)
        names = (match.name,) if match.name is not None else match.alike
        located = self._located(cloud, plane, names)
        if located and located[0].verdict.grade != FAILED:
            return self._named(located, match, plane)
        if self._is_mixed(located) and (hidden := self._hidden(cloud, plane, match)):
            return hidden
        if located:
            best = located[0]
            reason = f"{best.name} can't be laid on the cloud: {best.verdict.reason}"
            return TrayPart(UNPLACED, alike=names, verdict=best.verdict, match=match, reason=reason)
        return TrayPart(UNKNOWN, match=match, reason=match.reason)

    def _is_mixed(self, located: list[Located]) -> bool:
        """Whether much of the cloud seems to be something else than the part it was taken for."""
        if not located:
            return True
        # A swarm that did not find the part would say the same.
        exact = self._settings.registration == REGISTRATIONS[0]
        return exact and located[0].verdict.on_part_ratio < self._settings.verdict.on_part_min

    def _is_outside(self, points: Array) -> bool:
        edge = self._settings.edge_m
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        return bool(np.any(low < edge) or np.any(high > np.array(self._settings.size_m) - edge))

    def _located(self, cloud: PartCloud, plane: Plane, names: Sequence[str]) -> list[Located]:
        found = [self._laid(cloud, plane, name) for name in names]
        return sorted(found, key=lambda each: (each.verdict.grade == FAILED, each.fit.cost_m))

    def _laid(
        self, cloud: PartCloud, plane: Plane, name: str, middles: Array | None = None
    ) -> Located:
        settings, model = self._settings, self._models[name]
        if settings.registration == "pso" and middles is None:
            swarm = swarm_fit(cloud, model, plane, settings.seed, settings.swarm)
            fit = Fit(swarm.T_tray_part, swarm.mean_distance_m, float("inf"))
        else:
            fit = global_fit(cloud, model, plane, settings.search, middles)
        costs = fit.cost_m, fit.other_cost_m
        pose, alignment = fit.T_tray_part, fit.alignment
        return Located(name, fit, judge(cloud, model, pose, costs, alignment, settings.verdict))

    def _named(self, located: list[Located], match: Match, plane: Plane) -> TrayPart:
        best = located[0]
        limit = max(self._settings.alike_m, self._settings.alike_ratio * best.verdict.rmse_m)
        alike = [
            each.name
            for each in located
            if each.verdict.grade != FAILED and each.verdict.rmse_m <= limit
        ]
        if len(alike) > 1:
            reason = f"{' and '.join(alike)} can't be told apart, neither by descriptor nor by form"
            return TrayPart(ALIKE, alike=tuple(alike), match=match, reason=reason)
        pose = best.fit.T_tray_part
        lies = self._rest(best, plane)
        answer = KNOWN if best.verdict.grade == GOOD else UNPLACED
        alignment = best.fit.alignment
        return TrayPart(
            answer,
            best.name,
            (),
            lies,
            pose,
            None if alignment is None else alignment.covariance,
            best.verdict,
            match,
            f"{best.name}, {lies}, {best.verdict.grade}: {best.verdict.reason}",
        )

    def _rest(self, located: Located, plane: Plane) -> str:
        up = located.fit.T_tray_part[:3, :3].T @ plane.normal
        rests = self._models[located.name].rests
        return max(RESTS, key=lambda name: float(up @ rests[name].T[:, 2]))

    def _hidden(self, cloud: PartCloud, plane: Plane, match: Match) -> TrayPart | None:
        """The answer when one known part explains much of the cloud, but not all of it."""
        settings = self._settings
        low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
        shares = (np.arange(settings.hidden_grid) + 0.5) / settings.hidden_grid
        grid = np.stack(np.meshgrid(shares, shares, [0.0]), axis=-1).reshape(-1, 3)
        middles = low + grid * (high - low)
        for name in self._models:
            best = self._laid(cloud, plane, name, middles)
            verdict = best.verdict
            if (
                settings.on_part_hidden_min <= verdict.on_part_ratio < settings.verdict.on_part_min
                and verdict.complete_ratio >= settings.complete_hidden_min
                and self._sharp(cloud, best)
            ):
                share = 100.0 * verdict.on_part_ratio
                reason = (
                    f"overlapping parts: {share:.0f} % of the points lie on {name}, the others "
                    "belong to something that lies over or against it"
                )
                return TrayPart(OVERLAPPING, name, match=match, verdict=verdict, reason=reason)
        return None

    def _sharp(self, cloud: PartCloud, located: Located) -> bool:
        """Whether the points on the part lie on it as exactly as those of a part do."""
        model, limits = self._models[located.name], self._settings.verdict
        some = cloud.points[evenly(len(cloud.points), self._settings.search.most)]
        local = apply(inverse(located.fit.T_tray_part), some)
        distance = model.index.closest(local).distance
        on_part = distance[distance < limits.gate_m]
        return bool(np.median(on_part) < 0.1 * limits.gate_m)


def _text(place: Place) -> str:
    return f"({place.middle[0]:.3f}, {place.middle[1]:.3f}) m"
