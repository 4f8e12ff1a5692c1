"""Units of length, and what size an aircraft skin can have."""

import math

from skinplan.errors import MeshUnitError
from skinplan.mesh.model import Finding

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
LEAST_EXTENT_M = 0.05
LARGEST_EXTENT_M = 30.0
#: Parts outside this range are accepted, but the unit is doubted.
USUAL_EXTENT_M = (0.1, 15.0)
_PANEL_M = 2.0


def require_unit(name: str, unit: str) -> None:
    """Raises MeshUnitError when a unit, given for a file, is unknown."""
    if unit not in UNITS_M:
        raise MeshUnitError(
            f"the unit {unit!r} was given for {name}; accepted are {', '.join(UNITS_M)}"
        )


def require_part_size(name: str, extent: float, unit: str | None, factor: float) -> None:
    """Refuses a mesh that can't be a part in its unit.

    Args:
        name: Name of the file.
        extent: Largest extent, in the file's unit.
        unit: The unit that was stated; None when the file itself says it.
        factor: Its length [m].

    Raises:
        MeshUnitError: The part would be smaller than 0.05 m or larger than 30 m; names the likely
            unit.
    """
    size = extent * factor
    if LEAST_EXTENT_M <= size <= LARGEST_EXTENT_M:
        return
    hint = ""
    if unit is not None:
        likely = [
            other
            for other, length in UNITS_M.items()
            if LEAST_EXTENT_M <= extent * length <= LARGEST_EXTENT_M
        ]
        # Of several plausible units the one nearest to a usual panel is named first.
        likely.sort(key=lambda other: abs(math.log(extent * UNITS_M[other] / _PANEL_M)))
        hint = f"; did you mean unit {' or '.join(likely)}?" if likely else ""
    message = (
        f"{name} in {unit or 'its own unit'} would be {length_text(size)} long; "
        f"{LEAST_EXTENT_M} m to {LARGEST_EXTENT_M:g} m are accepted{hint}"
    )
    raise MeshUnitError(message, (Finding("unit implausible", 1, "refused", message),))


def unit_doubts(extent_m: float) -> list[Finding]:
    """Notes a size [m] that is accepted, but unusual enough to ask for the unit again."""
    least, largest = USUAL_EXTENT_M
    if least <= extent_m <= largest:
        return []
    factors = (
        (0.1, 0.01, 0.0254, 1 / 2.54) if extent_m > largest else (10.0, 25.4, 1 / 0.0254, 2.54)
    )
    others = [extent_m * factor for factor in factors if least <= extent_m * factor <= largest]
    likely = ", ".join(length_text(other) for other in others)
    detail = (
        f"the part is {length_text(extent_m)} long, which is unusual; with another unit it would "
        f"be {likely}"
    )
    return [Finding("unit doubtful", 1, "noted", detail)]


def length_text(size_m: float) -> str:
    """Returns a length in a unit that a person reads easily."""
    for limit, factor, name in ((1e-3, 1e6, "um"), (1.0, 1e3, "mm"), (1e3, 1.0, "m")):
        if size_m < limit:
            return f"{size_m * factor:.3g} {name}"
    return f"{size_m / 1e3:.3g} km"
