"""How a place on the surface stands in a coverage certificate: seen, or why not."""

from enum import IntEnum


class Sight(IntEnum):
    """State of a surface sample or a facet; of several that meet in a facet the highest counts.

    For what no view sees, the view that came nearest to seeing it gives the reason:

    1. a view for which only the ray is blocked: hidden, by what the ray meets first on its way
       from the surface (of several such views the first in the path);
    2. else a view that has it in its field and in its range: too oblique;
    3. else a view that has it in its field sideways, in front of it, before d_min or behind d_max:
       out of range;
    4. else it is not reached.

    What can't be seen from anywhere (`skinplan.scanner.seeable`) is CANNOT_BE_SEEN.
    """

    SEEN_OFTEN = 0
    SEEN = 1
    CANNOT_BE_SEEN = 2
    TOO_OBLIQUE = 3
    OUT_OF_RANGE = 4
    HIDDEN_BY_PART = 5
    HIDDEN_BY_FIXTURE = 6
    NOT_REACHED = 7


SIGHT_NAMES = (
    "seen often enough",
    "seen",
    "can't be seen",
    "too oblique",
    "out of range",
    "hidden by the part",
    "hidden by the fixture",
    "not reached",
)
# Red, green and blue, told apart with a weakness for red and green too: what is seen is dull, what
# is missed is bright.
SIGHT_COLOURS = (
    (120, 170, 130),
    (200, 215, 120),
    (90, 90, 90),
    (230, 120, 20),
    (240, 215, 30),
    (30, 90, 200),
    (120, 60, 170),
    (215, 30, 60),
)
