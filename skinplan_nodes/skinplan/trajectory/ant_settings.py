"""The constants of the modified ant colony (T S4), and what follows from them alone."""

import math
from dataclasses import dataclass, fields

from skinplan.errors import InputError


@dataclass(frozen=True)
class AntSettings:
    """Constants of the ant colony. The patent names them and gives no value.

    Attributes:
        ants: m. Some ants per node are enough; more cost time in proportion.
        iterations: n_max. With 2-opt, 60 nodes change no more after about half of these.
        pheromone_first: Exponent of the pheromone in the first iteration ...
        pheromone_last: ... and toward the last one, not greater: early on, the line s-d guides.
        heuristic_first: Exponent of 1/distance in the first iteration; above 0, because otherwise
            the first ants would not look at distances at all ...
        heuristic_last: ... and toward the last one, not smaller: it keeps late ants from repeating
            the best path only.
        evaporation: Share of the pheromone that an iteration takes, at first.
        evaporation_factor: What it is multiplied by when the best path is stagnant: less
            evaporation gives moves beside the best path time to be tried.
        evaporation_min: It is not made smaller than this.
        stagnation: v, iterations without a better path before evaporation is changed.
        depositing_first: Ants that deposit in the first iteration ...
        depositing_last: ... and in the last one: many keep the search wide, few settle it.
        deposit: Pheromone that the best ant adds to its moves when its path is as long as that of
            the nearest neighbour.
        map_scale: Map scale factor: first pheromone of a node on the line s-d.
        pheromone_min: No move has less pheromone: all stay possible.
        width_m: W, width of the working space perpendicular to s-d [m]; None = as wide as the
            nodes lie apart, the line in its middle.
        local_moves: Most moves of the local improvement of an iteration's best ant, 0 = none. Ours.
        travel_moves: Most moves of the improvement of the ants' order of features by the travel
            through them, 0 = none. Ours.

    Raises:
        InputError: A value out of range.
    """

    ants: int = 40
    iterations: int = 80
    pheromone_first: float = 2.0
    pheromone_last: float = 0.5
    heuristic_first: float = 1.0
    heuristic_last: float = 4.0
    evaporation: float = 0.2
    evaporation_factor: float = 0.9
    evaporation_min: float = 0.02
    stagnation: int = 8
    depositing_first: int = 10
    depositing_last: int = 3
    deposit: float = 0.5
    map_scale: float = 1.0
    pheromone_min: float = 0.01
    width_m: float | None = None
    local_moves: int = 200
    travel_moves: int = 50

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None and field.name == "width_m":
                continue
            self._require(field.name, not math.isnan(value) and value < math.inf, "finite")
        for name in ("ants", "iterations", "stagnation", "depositing_last"):
            self._require(name, getattr(self, name) >= 1, "1 or more")
        for name in ("pheromone_last", "heuristic_first", "local_moves", "travel_moves", "deposit"):
            self._require(name, getattr(self, name) >= 0, "0 or more")
        for name in ("map_scale", "pheromone_min"):
            self._require(name, getattr(self, name) > 0, "above 0")
        self._require("width_m", self.width_m is None or self.width_m >= 0, "None or 0 or more")
        self._require("evaporation", 0.0 < self.evaporation < 1.0, "between 0 and 1")
        self._require("evaporation_factor", 0.0 < self.evaporation_factor <= 1.0, "in (0, 1]")
        self._require(
            "evaporation_min", 0.0 < self.evaporation_min <= self.evaporation, "in (0, evaporation]"
        )
        self._require(
            "pheromone_first",
            self.pheromone_first >= self.pheromone_last,
            "pheromone_last or more: it falls",
        )
        self._require(
            "heuristic_last",
            self.heuristic_last >= self.heuristic_first,
            "heuristic_first or more: it rises",
        )
        self._require(
            "depositing_first",
            self.depositing_last <= self.depositing_first <= self.ants,
            "from depositing_last to ants",
        )

    def _require(self, name: str, good: bool, accepted: str) -> None:
        if not good:
            raise InputError(
                f"ant colony: {name}: accepted is {accepted}, found {getattr(self, name)}"
            )

    def exponents(self, iteration: int) -> tuple[float, float]:
        """Returns the exponents of pheromone and heuristic in an iteration, counted from 0.

        The pheromone's falls as a cosine, the heuristic's rises as a sine of a quarter turn (T S4).
        """
        angle = 0.5 * math.pi * iteration / self.iterations
        falling = self.pheromone_first - self.pheromone_last
        rising = self.heuristic_last - self.heuristic_first
        return (
            self.pheromone_last + falling * math.cos(angle),
            self.heuristic_first + rising * math.sin(angle),
        )

    def depositing(self, iteration: int) -> int:
        """Returns how many ants deposit in an iteration, counted from 0: evenly fewer (ours)."""
        share = iteration / max(self.iterations - 1, 1)
        return round(self.depositing_first + share * (self.depositing_last - self.depositing_first))
