"""What is said about the parts on a tray, and what it hangs on."""

from dataclasses import dataclass, field

from skinplan.recognition.database import Match, MatchSettings
from skinplan.recognition.global_fit import Fit, GlobalSettings
from skinplan.recognition.part_cloud import CutSettings, Place
from skinplan.recognition.planes import Plane
from skinplan.recognition.swarm import SwarmSettings
from skinplan.recognition.verdict import Verdict, VerdictSettings
from skinplan.transforms import Array

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
        beaten_ratio: A candidate that still lies this many times worse than one that fits is not
            laid exactly [1].
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
    beaten_ratio: float = 4.0
    complete_hidden_min: float = 0.6
    on_part_hidden_min: float = 0.5
    hidden_grid: int = 3
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
