"""The evaluation function of a scan pass (T S3): how far its depth and angles are from the best.

    E = 5e-5 * |1.2 d_max - d| * |phi - 0.6 phi_min| + lambda + mu * |psi - 0.3 psi_min|

as claim 1 of the granted US patent has it; psi stands for its second phi, the in-plane angle.

Reading notes. The patent states no units and no values:

- d and d_max count in millimetres, angles in degrees, the units of scanners' data sheets. At a
  stand-off of 300 mm of 400 mm a degree then costs 0.009, and 5e-5 makes E a number of the size of
  a scanner's error in millimetres; in metres and radians the constant would make it vanish.
- The angles are those between the view axis and the inward normal of the surface that a point
  stands for: phi out of the plane across the pass, that is along the motion, psi in it. Their
  magnitudes count: the errors found behind the function grow to both sides.
- phi_min and psi_min are the least angles of the scanner's design. 0 is taken (straight on): then E
  has its least value lambda where the stated findings have it, and is bilinear in depth and
  out-of-plane angle, as they say. Another scanner's can be given.
- lambda, "the penalty of the function", is the same for all poses and moves no optimum; constraints
  are kept here and not paid for, so it is 0.
- mu, "the penalty of the in-plane angle", per degree: 1e-5 * d_max is taken, the price of a degree
  out of plane at d_max (5e-5 * 0.2 d_max), the least that it ever has. So the two kinds of angle
  are comparable, and the out-of-plane angle, which the findings are about, goes first.
"""

import math
from dataclasses import dataclass, fields

import numpy as np

from skinplan.errors import InputError
from skinplan.scanner.model import CONE, ScannerModel
from skinplan.transforms import Array

_FACTOR = 5e-5  # of the claim, per millimetre and degree
_DEPTH = 1.2  # of d_max
_OUT_OF_PLANE = 0.6  # of phi_min
_IN_PLANE = 0.3  # of psi_min
_MU_PER_MM = 1e-5
_LEAST = 1e-9


@dataclass(frozen=True)
class PassSettings:
    """What the evaluation function and the search leave open.

    Attributes:
        out_of_plane_min_rad: phi_min, least out-of-plane angle of the scanner's design [rad].
        in_plane_min_rad: psi_min, least in-plane angle [rad].
        penalty: lambda.
        in_plane_factor: mu, per degree; None = 1e-5 per millimetre of d_max.
        least_gain: A pass is moved only when its E falls by this much ...
        least_gain_ratio: ... and by this share of itself: less is not worth another pose.
        halvings: A move that is not allowed is cut to the longest one that is, to within
            1 / 2^halvings of it.
        sweeps: At most so many times over the passes; a few are enough until none moves.

    Raises:
        InputError: A value out of range.
    """

    out_of_plane_min_rad: float = 0.0
    in_plane_min_rad: float = 0.0
    penalty: float = 0.0
    in_plane_factor: float | None = None
    least_gain: float = 1e-4
    least_gain_ratio: float = 0.02
    halvings: int = 3
    sweeps: int = 12

    def __post_init__(self) -> None:
        bounds = {
            "out_of_plane_min_rad": (0.0, math.pi / 3),
            "in_plane_min_rad": (0.0, math.pi / 3),
            "penalty": (0.0, 1e6),
            "in_plane_factor": (0.0, 1e6),
            "least_gain": (1e-9, 1e6),
            "least_gain_ratio": (1e-6, 1.0),
            "halvings": (0, 20),
            "sweeps": (1, 100),
        }
        for field in fields(self):
            value, (low, high) = getattr(self, field.name), bounds[field.name]
            if value is None and field.name == "in_plane_factor":
                continue
            if not low <= value <= high:
                raise InputError(
                    f"pass optimisation: {field.name}: found {value}; accepted is a number from "
                    f"{low:g} to {high:.6g}"
                )

    @property
    def best_out_of_plane_rad(self) -> float:
        """Out-of-plane angle at which E is least [rad]."""
        return _OUT_OF_PLANE * self.out_of_plane_min_rad

    @property
    def best_in_plane_rad(self) -> float:
        """In-plane angle at which E is least [rad]."""
        return _IN_PLANE * self.in_plane_min_rad


def pass_error(
    depth_m: Array | float,
    out_of_plane_rad: Array | float,
    in_plane_rad: Array | float,
    range_max_m: float,
    settings: PassSettings,
) -> Array:
    """Returns E of the US patent's claim 1 (T S3), shape as given; units: see the module.

    Args:
        depth_m: d, distance from the scanner to the surface along the view axis [m].
        out_of_plane_rad: phi; its sign does not matter [rad].
        in_plane_rad: psi; its sign does not matter [rad].
        range_max_m: d_max of the scanner [m].
        settings: phi_min, psi_min, lambda and mu.
    """
    deepest_mm = 1000.0 * range_max_m
    mu = settings.in_plane_factor
    mu = _MU_PER_MM * deepest_mm if mu is None else mu
    depth = np.abs(_DEPTH * deepest_mm - 1000.0 * np.asarray(depth_m, dtype=float))
    out = np.rad2deg(np.abs(np.abs(out_of_plane_rad) - settings.best_out_of_plane_rad))
    inside = np.rad2deg(np.abs(np.abs(in_plane_rad) - settings.best_in_plane_rad))
    return np.asarray(_FACTOR * depth * out + settings.penalty + mu * inside)


def frames(normals: Array, motions: Array, toward: Array) -> tuple[Array, Array]:
    """Returns the directions in which angles of passes are counted.

    Where there is no motion (a single viewpoint has none) its whole tilt counts as out of plane.

    Args:
        normals: Outward unit normals of the surface, shape (n, 3).
        motions: Directions of the passes, any length, zero = none, shape (n, 3).
        toward: Unit directions from the surface to the scanner, shape (n, 3).

    Returns:
        Unit vectors in the surface along the motion and across it, shape (n, 3) each.
    """
    # Of the motion, the tilt and the axis least along the normal: the first that has a length.
    others = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    along = np.zeros_like(normals)
    for wanted in (motions, toward, others):
        flat = wanted - np.einsum("ij,ij->i", wanted, normals)[:, None] * normals
        length = np.linalg.norm(flat, axis=1, keepdims=True)
        open_ = ~along.any(axis=1, keepdims=True) & (length > _LEAST)
        along = np.where(open_, flat / np.maximum(length, _LEAST), along)
    return along, np.cross(normals, along)


def angles_of(toward: Array, normals: Array, along: Array, across: Array) -> tuple[Array, Array]:
    """Returns the out-of-plane and the in-plane angle of view axes, with signs, shape (n,) [rad].

    Args:
        toward: Unit directions from the surface to the scanner, shape (n, 3).
        normals: Outward unit normals, shape (n, 3).
        along: Unit vectors along the motion, in the surface, shape (n, 3).
        across: Unit vectors across it, in the surface, shape (n, 3).
    """
    high = np.einsum("ij,ij->i", toward, normals)
    return (
        np.arctan2(np.einsum("ij,ij->i", toward, along), high),
        np.arctan2(np.einsum("ij,ij->i", toward, across), high),
    )


def toward_of(
    out_of_plane: Array, in_plane: Array, normals: Array, along: Array, across: Array
) -> Array:
    """Returns unit directions from the surface to the scanner, shape (n, 3): undoes `angles_of`.

    Args:
        out_of_plane: Within a right angle, shape (n,) [rad].
        in_plane: Within a right angle, shape (n,) [rad].
        normals: Outward unit normals, shape (n, 3).
        along: As in `angles_of`.
        across: As in `angles_of`.
    """
    result = normals + np.tan(out_of_plane)[:, None] * along + np.tan(in_plane)[:, None] * across
    return np.asarray(result / np.linalg.norm(result, axis=1, keepdims=True))


def effective_width(
    depth_m: Array, toward: Array, normals: Array, across: Array, scanner: ScannerModel
) -> Array:
    """Returns how wide a strip of flat surface poses see across their pass, shape (n,) [m].

    With c the sine between view axis and the direction across, the point at x across lies
    |x| sqrt(1 - c^2) beside the axis, which the field's radius limits, at the depth d - x c, which
    the range limits (M2.1). Straight on it is the diameter of the field; a tilt lets one side leave
    the range. Too oblique a view sees nothing.

    Args:
        depth_m: Of the surface along the axis, shape (n,) [m].
        toward: Unit directions from the surface to the scanner, shape (n, 3).
        normals: Outward unit normals, shape (n, 3).
        across: Unit vectors across the pass, in the surface, shape (n, 3).
        scanner: Field of view, range and incidence limit.
    """
    sine = np.abs(np.einsum("ij,ij->i", toward, across))
    cosine = np.sqrt(np.maximum(1.0 - sine**2, 0.0))
    if scanner.field == CONE:
        slope = scanner.field_radius_m / scanner.range_min_m
        near = _ratio(slope * depth_m, cosine + slope * sine)
        far = _ratio(slope * depth_m, cosine - slope * sine)
    else:
        near = far = _ratio(np.full_like(depth_m, scanner.field_radius_m), cosine)
    near = np.minimum(near, _ratio(depth_m - scanner.range_min_m, sine))
    far = np.minimum(far, _ratio(scanner.range_max_m - depth_m, sine))
    facing = np.einsum("ij,ij->i", toward, normals) >= np.cos(scanner.incidence_max_rad) - _LEAST
    inside = (depth_m >= scanner.range_min_m - _LEAST) & (depth_m <= scanner.range_max_m + _LEAST)
    return np.where(facing & inside, np.maximum(near, 0.0) + np.maximum(far, 0.0), 0.0)


def _ratio(lengths: Array, slopes: Array) -> Array:
    """Lengths divided by slopes; without a slope nothing limits."""
    return np.where(slopes > _LEAST, lengths / np.where(slopes > _LEAST, slopes, 1.0), np.inf)
