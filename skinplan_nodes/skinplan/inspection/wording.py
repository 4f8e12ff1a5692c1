"""Figures as a reader wants them: units, digits, a dash for what is not known."""

import math
from typing import Any

from skinplan.inspection.run_files import number

_NOTHING = "–"


def plain(value: Any) -> str:
    """Returns a value as text.

    Numbers with at most four digits after the point, nothing as a dash.
    """
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return _NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4f}".rstrip("0").rstrip(".") or "0"
    return str(value) or _NOTHING


def percent(value: Any) -> str:
    """Returns a share as percent."""
    found = number(value)
    return f"{100 * found:.2f} %" if math.isfinite(found) else _NOTHING


def millimetres(value: Any, digits: int = 3, sign: bool = False) -> str:
    """Returns a length [m] in millimetres."""
    found = number(value) * 1e3
    return f"{found:{'+' if sign else ''}.{digits}f} mm" if math.isfinite(found) else _NOTHING


def degrees(value: Any, digits: int = 3) -> str:
    """Returns an angle [rad] in degrees."""
    found = math.degrees(number(value))
    return f"{found:.{digits}f}°" if math.isfinite(found) else _NOTHING


def seconds(value: Any) -> str:
    """Returns a duration [s]."""
    found = number(value)
    if not math.isfinite(found):
        return _NOTHING
    return (
        f"{found:.2f} s"
        if found < 10
        else f"{found:.0f} s"
        if found < 600
        else f"{found / 60:.0f} min"
    )


def count(value: Any) -> str:
    """Returns a whole number with separators."""
    found = number(value)
    return f"{found:,.0f}" if math.isfinite(found) else _NOTHING


def place(value: Any) -> str:
    """Returns a place or an extent [m] in millimetres."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        return _NOTHING
    numbers = [number(each) * 1e3 for each in value]
    if not all(math.isfinite(each) for each in numbers):
        return _NOTHING
    return ", ".join(f"{round(each)}" for each in numbers) + " mm"
