"""What contact measurement is planned with: the values of C, and our own where C has none."""

from dataclasses import dataclass, field, fields
from math import isfinite, pi, radians

import numpy as np

from skinplan.errors import InputError
from skinplan.robot.dh import Capsule
from skinplan.transforms import Array, inverse, transform

# The mirror's frame on the flange: +x out of the mirror, along the flange's x; +z along the
# flange's z.
_NO_TURN = np.eye(3)


@dataclass(frozen=True)
class ProbeTool:
    """Touch probe with a T-Mac beside it on the flange (C 2.3, Fig. 4).

    C publishes no figure of it: these are estimates. The probe is on the axis of the last joint, so
    that a turn about it (roll) costs no reach; the T-Mac looks sideways, so that roll turns it to
    the tracker.

    Attributes:
        probe_length_m: Flange to the middle of the ball, along the flange's z [m].
        ball_radius_m: Radius of the ball [m].
        body_length_m: Length of adapter and probe body from the flange on [m].
        body_radius_m: Radius of both [m].
        stylus_radius_m: Radius of the stylus [m].
        mirror_m: Middle of the T-Mac's mirror on the flange, (x, y, z) [m]; it looks along x.
        tmac_depth_m: The T-Mac's body reaches so far behind its mirror [m].
        tmac_radius_m: Its radius [m].
    """

    probe_length_m: float = 0.35
    ball_radius_m: float = 0.003
    body_length_m: float = 0.15
    body_radius_m: float = 0.03
    stylus_radius_m: float = 0.003
    mirror_m: tuple[float, float, float] = (0.13, 0.0, 0.07)
    tmac_depth_m: float = 0.10
    tmac_radius_m: float = 0.055

    @property
    def T_tool0_probe(self) -> Array:
        """Ball on the flange, ``f_m T`` of eq (3), (4, 4) [m]; +z is the probing direction."""
        return transform((0.0, 0.0, self.probe_length_m))

    @property
    def T_mirror_probe(self) -> Array:
        """Ball in the frame of the mirror, ``m_t T`` of eq (4), shape (4, 4) [m]."""
        return inverse(transform(self.mirror_m, _NO_TURN)) @ self.T_tool0_probe

    @property
    def bodies(self) -> dict[str, Capsule]:
        """Capsules in the flange's frame; the stylus ends 10 mm before what it touches."""
        x, y, z = self.mirror_m
        radius = self.tmac_radius_m
        start = min(self.body_radius_m + 0.005, self.body_length_m)
        tip = max(self.probe_length_m - 0.010 - self.stylus_radius_m, self.body_length_m)
        inner = max(x - self.tmac_depth_m + radius, 0.0)
        end = max(self.body_length_m - self.body_radius_m, start)
        return {
            "probe": _along_z(start, end, self.body_radius_m),
            "stylus": _along_z(self.body_length_m, tip, self.stylus_radius_m),
            "T-Mac": Capsule((min(inner, x - radius), y, z), (x - radius, y, z), radius),
        }


def _along_z(start: float, end: float, radius: float) -> Capsule:
    return Capsule((0.0, 0.0, start), (0.0, 0.0, end), radius)


@dataclass(frozen=True)
class TrackerLimits:
    """When a laser tracker holds the T-Mac (C 4: limits of emission and incidence).

    C names the limits without figures. Taken are figures usual for trackers with a target of six
    degrees of freedom: the beam leaves within 45 degrees of the horizontal, any way around, meets
    the mirror within 45 degrees of its normal, and is 1.5 to 15 m long.

    Attributes:
        emission_max_rad: Largest angle of the beam to the horizontal at the tracker [rad].
        incidence_max_rad: Largest angle between the beam and the mirror's normal [rad].
        range_min_m: Shortest beam [m].
        range_max_m: Longest beam [m].
        beam_clearance_m: The beam keeps this from arm and tool [m].
    """

    emission_max_rad: float = radians(45.0)
    incidence_max_rad: float = radians(45.0)
    range_min_m: float = 1.5
    range_max_m: float = 15.0
    beam_clearance_m: float = 0.02


@dataclass(frozen=True)
class AxialRadialSettings:
    """Figures of the station algorithm (C 3.1, C 4).

    Attributes:
        step_m: Delta L, radial step [m].
        k_max: K_max, number of radial steps.
        stations_max: S_num at which the search ends.
        overlap_required: The sum of the counts must be greater than the number of points, as step
            (9) says; one station then never does. False = all points covered is enough.
        middle_of_ties: Of steps k with equal counts take the middle one; False = the smallest.
    """

    step_m: float = 0.2
    k_max: int = 10
    stations_max: int = 8
    overlap_required: bool = True
    middle_of_ties: bool = False


@dataclass(frozen=True)
class ContactSettings:
    """The whole cell for contact measurement.

    Attributes:
        robot: Name of the arm model.
        base_height_m: The arm's base above the floor [m].
        base_size_m: Length along x and width along y of the vehicle below the arm [m]; it is as
            high as the arm's base. Not published: an estimate.
        heading_rad: Heading of arm and vehicle in the axial frame [rad]; 0 = axes parallel to the
            world's (C 3.1 step 7).
        margin_m: Distance kept between arm, tool, vehicle and part [m].
        approach_m: Distance from the surface at which the probe moves from point to point [m].
        rolls: Number of turns about the probe that are tried.
        tool: Probe and T-Mac.
        tracker: Limits of the tracker.
        stations: Figures of the station algorithm.
        collision_counts: A pose that collides does not count as reached. False = kinematics alone,
            as step (8) is written.
    """

    robot: str = "gcr14_1400"
    base_height_m: float = 0.752
    base_size_m: tuple[float, float] = (0.90, 0.70)
    heading_rad: float = 0.0
    margin_m: float = 0.01
    approach_m: float = 0.06
    rolls: int = 24
    tool: ProbeTool = field(default_factory=ProbeTool)
    tracker: TrackerLimits = field(default_factory=TrackerLimits)
    stations: AxialRadialSettings = field(default_factory=AxialRadialSettings)
    collision_counts: bool = True


_RANGES: dict[str, tuple[float, float]] = {
    "probe_length_m": (0.01, 2.0),
    "ball_radius_m": (1e-4, 0.05),
    "body_length_m": (0.0, 2.0),
    "body_radius_m": (0.0, 0.3),
    "stylus_radius_m": (0.0, 0.1),
    "tmac_depth_m": (0.0, 0.5),
    "tmac_radius_m": (0.0, 0.3),
    "emission_max_rad": (1e-3, 0.5 * pi),
    "incidence_max_rad": (1e-3, 0.5 * pi),
    "range_min_m": (0.0, 50.0),
    "range_max_m": (1e-3, 200.0),
    "beam_clearance_m": (0.0, 0.5),
    "step_m": (1e-3, 5.0),
    "k_max": (1, 1000),
    "stations_max": (1, 100),
    "base_height_m": (0.0, 5.0),
    "heading_rad": (-2.0 * pi, 2.0 * pi),
    "margin_m": (0.0, 0.2),
    "approach_m": (1e-3, 0.5),
    "rolls": (1, 360),
}


def require_settings(settings: ContactSettings) -> ContactSettings:
    """Returns settings whose figures are all in range.

    Raises:
        InputError: A figure that is not finite or out of range (lengths in mm, angles in degrees).
    """
    for group in (settings, settings.tool, settings.tracker, settings.stations):
        for entry in fields(group):
            value = getattr(group, entry.name)
            low, high = _RANGES.get(entry.name, (-np.inf, np.inf))
            if entry.name in _RANGES and not (isfinite(value) and low <= value <= high):
                raise InputError(
                    f"contact settings, {entry.name}: {value} was found; {low:g} to {high:g} is "
                    "accepted (metres, radians)"
                )
    if settings.tracker.range_min_m >= settings.tracker.range_max_m:
        raise InputError(
            f"contact settings: the tracker's range {settings.tracker.range_min_m} to "
            f"{settings.tracker.range_max_m} m is empty; range_min_m < range_max_m is accepted"
        )
    return settings
