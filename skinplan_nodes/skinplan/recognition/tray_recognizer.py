"""What lies on the tray, which parts it is, and where: the whole chain (R2.2, R2.3).

Nothing is guessed: what is unknown, alike, overlapping or half outside is named.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import trimesh

from skinplan.errors import NoCloudError
from skinplan.inspection.points import checked_points, evenly
from skinplan.recognition.database import RESTS, Match, ModelDatabase
from skinplan.recognition.fit_model import FitModel
from skinplan.recognition.global_fit import Fit, exact_fit, global_fit, global_start
from skinplan.recognition.part_cloud import PartCloud, Place, part_cloud, places
from skinplan.recognition.planes import Plane, find_plane
from skinplan.recognition.swarm import swarm_fit
from skinplan.recognition.tray_answers import (
    ALIKE,
    KNOWN,
    OUTSIDE,
    OVERLAPPING,
    REGISTRATIONS,
    UNKNOWN,
    UNPLACED,
    Located,
    TrayContents,
    TrayPart,
    TraySettings,
)
from skinplan.recognition.verdict import FAILED, GOOD, judge
from skinplan.strategies import chosen
from skinplan.transforms import Array, apply, inverse


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
        if self._is_mixed(located) and (found := self._by_form(cloud, plane, match, bool(located))):
            return found
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
        """Lays models on the cloud, the best first."""
        starts = [(name, self._start(cloud, plane, name)) for name in names]
        found: list[Located] = []
        for name, start in sorted(starts, key=lambda each: each[1].cost_m):
            # What another one that fits has left far behind need not be laid exactly.
            beaten = any(
                other.verdict.grade != FAILED
                and start.cost_m > self._settings.beaten_ratio * other.fit.cost_m
                for other in found
            )
            fit = start if beaten else self._exact(cloud, name, start)
            found.append(self._judged(cloud, name, fit))
        return sorted(found, key=lambda each: (each.verdict.grade == FAILED, each.fit.cost_m))

    def _start(self, cloud: PartCloud, plane: Plane, name: str) -> Fit:
        settings, model = self._settings, self._models[name]
        if settings.registration == "pso":
            swarm = swarm_fit(cloud, model, plane, settings.seed, settings.swarm)
            return Fit(swarm.T_tray_part, swarm.mean_distance_m, float("inf"))
        return global_start(cloud, model, plane, settings.search)

    def _exact(self, cloud: PartCloud, name: str, start: Fit) -> Fit:
        if self._settings.registration == "pso":
            return start
        return exact_fit(cloud, self._models[name], start, self._settings.search)

    def _judged(self, cloud: PartCloud, name: str, fit: Fit) -> Located:
        model, costs = self._models[name], (fit.cost_m, fit.other_cost_m)
        limits = self._settings.verdict
        return Located(
            name, fit, judge(cloud, model, fit.T_tray_part, costs, fit.alignment, limits)
        )

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

    def _by_form(
        self, cloud: PartCloud, plane: Plane, match: Match, tried: bool
    ) -> TrayPart | None:
        """The answer of registration alone, where the descriptor has none that holds.

        A model that explains all of the cloud is the part, however odd the descriptor: thinning
        may have taken one side of a thin sheet. One that explains much of it lies below something.
        Most often it is the nearest one, and the others need not be tried; `tried` says that it was
        laid on the cloud already and failed.
        """
        near = () if tried else self._database.alike(match.distances, self._settings.match)
        located = self._located(cloud, plane, near)
        if located and located[0].verdict.grade != FAILED:
            return self._named(located, match, plane)
        found = self._everywhere(cloud, plane)
        whole = [each.name for each in found if each.verdict.grade != FAILED]
        located = self._located(cloud, plane, whole)
        if located and located[0].verdict.grade != FAILED:
            return self._named(located, match, plane)
        return self._hidden(cloud, found, match)

    def _everywhere(self, cloud: PartCloud, plane: Plane) -> list[Located]:
        """All models, each with its middle anywhere over the cloud."""
        low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
        count = self._settings.hidden_grid
        shares = (np.arange(count) + 0.5) / count
        grid = np.stack(np.meshgrid(shares, shares, [0.0]), axis=-1).reshape(-1, 3)
        middles = low + grid * (high - low)
        return [
            self._judged(
                cloud, name, global_fit(cloud, model, plane, self._settings.search, middles)
            )
            for name, model in self._models.items()
        ]

    def _hidden(self, cloud: PartCloud, found: list[Located], match: Match) -> TrayPart | None:
        """The answer when one known part explains much of the cloud, but not all of it."""
        below = [each for each in found if self._is_below(cloud, each)]
        if not below:
            return None
        best = max(below, key=lambda each: each.verdict.on_part_ratio)
        share = 100.0 * best.verdict.on_part_ratio
        reason = (
            f"overlapping parts: {share:.0f} % of the points lie on {best.name}, the others belong "
            "to something that lies over or against it"
        )
        return TrayPart(OVERLAPPING, best.name, match=match, verdict=best.verdict, reason=reason)

    def _is_below(self, cloud: PartCloud, located: Located) -> bool:
        """Whether a part explains much of the cloud, and exactly, but not all of it."""
        settings, verdict = self._settings, located.verdict
        return (
            settings.on_part_hidden_min <= verdict.on_part_ratio < settings.verdict.on_part_min
            and verdict.complete_ratio >= settings.complete_hidden_min
            and self._sharp(cloud, located)
        )

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
