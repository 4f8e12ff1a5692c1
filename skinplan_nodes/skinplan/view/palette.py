"""Colours of the pictures: told apart with any kind of colour vision, and in grey where it counts.

All are red, green, blue in [0, 1].
"""

import numpy as np
from matplotlib import colormaps

from skinplan.transforms import Array

Colour = tuple[float, float, float]

INK: Colour = (0.13, 0.14, 0.16)
FAINT: Colour = (0.45, 0.47, 0.50)
SURFACE: Colour = (0.80, 0.82, 0.84)
OUTLINE: Colour = (0.20, 0.22, 0.25)
HOLE_EDGE: Colour = (0.75, 0.00, 0.45)

ROW_POINT: Colour = (0.00, 0.33, 0.62)
FEATURE_POINT: Colour = (0.84, 0.37, 0.00)
SKIPPED: Colour = (0.0, 0.0, 0.0)

HOLE_FRAME: Colour = (0.68, 0.00, 0.30)
FIELD: Colour = (0.95, 0.73, 0.10)

_TIME_MAP = colormaps["plasma"]

SERIES: tuple[Colour, ...] = (
    (0.00, 0.45, 0.70),
    (0.90, 0.62, 0.00),
    (0.00, 0.62, 0.45),
    (0.80, 0.47, 0.65),
    (0.34, 0.71, 0.91),
    (0.84, 0.37, 0.00),
    (0.94, 0.89, 0.26),
)


def series(number: int) -> Colour:
    """Returns the colour of region, station or row ``number``, from 0; they repeat after seven."""
    return SERIES[number % len(SERIES)]


def region_colours(count: int) -> Array:
    """Returns the colours of the flat surface and of regions 1 to ``count``, (count + 1, 3)."""
    return np.array([SURFACE, *(series(number) for number in range(count))])


def time_colours(shares: Array) -> Array:
    """Returns the colours of times, shape (n, 3): dark blue at 0, red halfway, orange at 1.

    Args:
        shares: Of the whole time [1], shape (n,); what is outside [0, 1] has the colour of the end.
    """
    # The map's last colours are too light for a line on a light part.
    return np.asarray(_TIME_MAP(0.86 * np.clip(shares, 0.0, 1.0)))[:, :3]
