"""Classes of the outlines on the tray, by area and sides (R 1), and the part to scan of each.

What a part looks like depends on where it lies: the camera sees its sides, too, and what is higher
appears farther out. So an outline is compared with that which each type would have at its place.
Types that look alike there share a class; none is guessed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import trimesh

from skinplan.errors import InputError
from skinplan.recognition.tray_image import Blob
from skinplan.recognition.tray_looks import Look, Looks
from skinplan.recognition.tray_view import TrayView
from skinplan.transforms import Array


@dataclass(frozen=True)
class ClassSettings:
    """When an outline is of a class.

    Attributes:
        deviation_max: Area and both sides may differ from those of the type by this share [1] ...
        slack_m: ... and the sides by this length besides, the area by that of half of it all round
            [m].
        alike: Types whose deviation is larger than the least by at most this can't be told apart.
        open_m: Opening of the images, as in `BlobSettings` [m].
        outside_m: A part may reach so far over the edge of the tray [m].
    """

    deviation_max: float = 0.06
    slack_m: float = 0.002
    alike: float = 0.04
    open_m: float = 0.009
    outside_m: float = 0.005


@dataclass(frozen=True, eq=False)
class Sighting:
    """What an outline is taken for.

    Attributes:
        blob: The outline.
        names: Types that it may be, the best first; several = they look alike from above; none = it
            is of no class.
        deviation: Deviation of the best type, or of the nearest when there is none [1].
        place: Where the middle of the part's box is over the tray, corrected for its height, shape
            (2,) [m]; that of the outline without a class.
        answer: What is wrong with it, one sentence; empty when it has a class.
    """

    blob: Blob
    names: tuple[str, ...]
    deviation: float
    place: Array
    answer: str = ""

    @property
    def label(self) -> str:
        """The class in words."""
        return " or ".join(self.names) if self.names else "no class"


@dataclass(frozen=True, eq=False)
class TrayFinding:
    """What lies on the tray.

    Attributes:
        sightings: One for each outline, the largest first.
        answer: What is to be said about the tray, one sentence; empty = all have a class.
    """

    sightings: tuple[Sighting, ...]
    answer: str = ""

    def to_scan(self, tray_middle: Array) -> dict[tuple[str, ...], Sighting]:
        """Returns the part of each class nearest to the middle of the tray, shape (2,) [m]."""
        chosen: dict[tuple[str, ...], Sighting] = {}
        for each in self.sightings:
            key = tuple(sorted(each.names))
            if key and (
                key not in chosen
                or np.linalg.norm(each.place - tray_middle)
                < np.linalg.norm(chosen[key].place - tray_middle)
            ):
                chosen[key] = each
        return chosen


@dataclass(frozen=True, eq=False)
class Classifier:
    """Compares outlines with the types of the tray.

    Attributes:
        view: Camera and tray.
        models: Meshes of the types, lying as they are put on the tray (z up) [m].
        settings: Figures.
    """

    view: TrayView
    models: Mapping[str, trimesh.Trimesh]
    settings: ClassSettings = field(default_factory=ClassSettings)

    def __post_init__(self) -> None:
        """Refuses an empty set of types."""
        if not self.models:
            raise InputError("no part types were given; at least one model is accepted")

    def find(self, outlines: Sequence[Blob]) -> TrayFinding:
        """Says what outlines are.

        Args:
            outlines: Of `skinplan.recognition.tray_image.blobs`.

        Returns:
            The classes, and an answer when the tray is empty or something has none.
        """
        if not outlines:
            return TrayFinding((), "the tray is empty: nothing on it differs from the background")
        sightings = tuple(self.sighting(blob) for blob in outlines)
        odd = [each for each in sightings if each.answer]
        if not odd:
            return TrayFinding(sightings)
        return TrayFinding(
            sightings, f"{len(odd)} of {len(sightings)} outlines are refused: {odd[0].answer}"
        )

    def sighting(self, blob: Blob) -> Sighting:
        """Says what one outline is."""
        ranked = self._ranked(
            Looks(self.view, self.models, self.settings.slack_m, self.settings.open_m).of(blob)
        )
        fits = [look for look in ranked if look.deviation <= self.settings.deviation_max]
        if not fits:
            return self._refused(blob, ranked)
        least = fits[0].deviation
        names = tuple(look.name for look in fits if look.deviation <= least + self.settings.alike)
        answer = ""
        if fits[0].outside_m > self.settings.outside_m:
            answer = (
                f"{' or '.join(names)} at {_at(fits[0].place)} reaches "
                f"{1e3 * fits[0].outside_m:.0f} mm over the edge of the tray; parts that lie on "
                "it are accepted"
            )
        return Sighting(blob, names, least, fits[0].place, answer)

    def _refused(self, blob: Blob, ranked: list[Look]) -> Sighting:
        size = f"{1e3 * blob.size_m[0]:.0f} x {1e3 * blob.size_m[1]:.0f} mm"
        if blob.cut_off:
            answer = (
                f"an outline of {size} at {_at(blob.centre)} lies half outside the tray; parts "
                "that lie on it are accepted"
            )
        else:
            near = (
                f"nearest is {ranked[0].name}, {100 * ranked[0].deviation:.0f} % off"
                if ranked
                else "no type is nearly as large"
            )
            answer = (
                f"an outline of {size} and {1e4 * blob.area_m2:.0f} cm2 at {_at(blob.centre)} "
                f"is of no class ({near}); parts of {', '.join(self.models)} that do not touch or "
                "overlap are accepted"
            )
        deviation = ranked[0].deviation if ranked else float("inf")
        return Sighting(blob, (), deviation, blob.centre, answer)

    def _ranked(self, looks: Sequence[Look]) -> list[Look]:
        """The types, each with its least deviation, the best first.

        The figures say which types it may be; where a type lies is said by the way to lie whose
        outline covers that of the blob best.
        """
        by_type: dict[str, list[Look]] = {}
        for look in looks:
            by_type.setdefault(look.name, []).append(look)
        chosen = [
            replace(
                min(ways, key=lambda look: round(look.apart, 6)),
                deviation=min(look.deviation for look in ways),
            )
            for ways in by_type.values()
        ]
        return sorted(chosen, key=lambda look: round(look.deviation, 9))


def _at(place: Array) -> str:
    return f"({place[0]:.3f}, {place[1]:.3f}) m"
