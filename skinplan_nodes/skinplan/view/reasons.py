"""Why points are not scanned: kinds of reasons with their colours, and how often each occurs."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.artist import Artist
from matplotlib.lines import Line2D

from skinplan.stations.model import SkippedPoint
from skinplan.view.palette import Colour

_MOST_TOLD = 5
# Where a reason was found: it differs from point to point.
_PLACE = re.compile(r",? ?\(?at best, from \([^)]*\) m\)?")


@dataclass(frozen=True)
class Kind:
    """A kind of reason.

    Attributes:
        name: For legends.
        colour: Of the crosses; none is a station's colour.
        beginnings: How reasons of this kind begin.
    """

    name: str
    colour: Colour
    beginnings: tuple[str, ...]


OUT_OF_REACH = Kind("out of the arm's reach", (0.0, 0.0, 0.0), ("out of the arm's reach",))
SINGULAR = Kind("too close to singular", (0.45, 0.25, 0.05), ("too close to a singular",))
LIMITS = Kind("joint limits", (0.36, 0.10, 0.60), ("joint limits",))
COLLISION = Kind("collision", (0.86, 0.05, 0.10), ("collision of",))
HIDDEN = Kind("not seen by the tracker", (0.93, 0.05, 0.72), ("the scanner is",))
EXACT_BASE = Kind(
    "only while the base stands exactly on its goal", (0.45, 0.47, 0.10), ("reached only while",)
)
OTHER = Kind("another reason", (0.45, 0.47, 0.50), ())
KINDS = (OUT_OF_REACH, SINGULAR, LIMITS, COLLISION, HIDDEN, EXACT_BASE, OTHER)


def kind_of(reason: str) -> Kind:
    """Returns the kind of a reason as the records and the plans word it."""
    return next((kind for kind in KINDS if reason.startswith(kind.beginnings)), OTHER)


def reason_of_points(skipped: Sequence[SkippedPoint]) -> dict[int, str]:
    """Returns the first reason of each point that is not scanned, without where it was found."""
    result: dict[int, str] = {}
    for entry in skipped:
        result.setdefault(entry.point, _PLACE.sub("", entry.reason).strip())
    return result


def skipped_sentence(skipped: Sequence[SkippedPoint]) -> str:
    """Returns how many points are not scanned and why, one sentence."""
    reasons = reason_of_points(skipped)
    if not reasons:
        return "All points are scanned."
    counts = Counter(reasons.values()).most_common()
    told = "; ".join(f"{count} × {reason}" for reason, count in counts[:_MOST_TOLD])
    left = sum(count for _, count in counts[_MOST_TOLD:])
    more = f"; {left} × {len(counts) - _MOST_TOLD} other reasons" if left else ""
    points = len(reasons)
    return f"{points} point{'' if points == 1 else 's'} not scanned: {told}{more}."


def kinds_of_points(skipped: Sequence[SkippedPoint]) -> dict[Kind, list[int]]:
    """Returns the points that are not scanned by kind of reason, kinds in their fixed order."""
    found: dict[Kind, list[int]] = {kind: [] for kind in KINDS}
    for point, reason in sorted(reason_of_points(skipped).items()):
        found[kind_of(reason)].append(point)
    return {kind: points for kind, points in found.items() if points}


def cross_handle(kind: Kind, label: str) -> Artist:
    """Returns the legend of the crosses of a kind."""
    return Line2D(
        [], [], linestyle="none", marker="x", color=kind.colour, markersize=8, markeredgewidth=2,
        label=label,
    )  # fmt: skip


def cross_handles(skipped: Sequence[SkippedPoint]) -> list[Artist]:
    """Returns the legend of the points that are not scanned: each kind with its count."""
    return [
        cross_handle(kind, f"{len(points)} not scanned: {kind.name}")
        for kind, points in kinds_of_points(skipped).items()
    ]
