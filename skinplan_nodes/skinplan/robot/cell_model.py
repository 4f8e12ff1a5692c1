"""The cell: what stands where, and the limits of its devices.

Frames (README has the table): ``map`` -> ``base_link`` -> ``arm_base`` -> ... -> ``tool0`` ->
``scanner``; ``base_link`` -> ``camera_link`` -> ``camera_color_optical_frame``; ``map`` ->
``tracker``.
"""

from dataclasses import dataclass, field

import numpy as np

from skinplan.transforms import Array, planar, transform

# Scanner frame on the flange: +x (view direction) along tool z, origin 0.15 m in front of the
# flange.
_TOOL_TO_SCANNER = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
# camera_link (x forward, y left, z up) to the optical frame (x right, y down, z forward), REP-103.
_LINK_TO_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_TURN_LEFT = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class CameraConfig:
    """The localisation camera: figures of a RealSense D435 colour stream.

    Attributes:
        width: Image width [px].
        height: Image height [px].
        K: Camera matrix, shape (3, 3) [px].
        D: Distortion coefficients, shape (5,) of model ``plumb_bob`` or (8,) of model
            ``rational_polynomial``.
        T_base_link_camera_link: Hand-eye calibration, shape (4, 4) [m]: the camera stands on the
            base and looks to the left.
        mounting_error_m: Standard deviation of that calibration's translation, each axis [m].
        mounting_error_rad: ... and of its rotation [rad].
        corners: How corners of markers are found: ``auto``, ``lines`` or ``subpix``.
    """

    width: int = 1280
    height: int = 720
    K: Array = field(
        default_factory=lambda: np.array(
            [[915.0, 0.0, 640.5], [0.0, 915.0, 361.0], [0.0, 0.0, 1.0]]
        )
    )
    D: Array = field(default_factory=lambda: np.array([0.08, -0.15, 0.0005, -0.0004, 0.0]))
    T_base_link_camera_link: Array = field(
        default_factory=lambda: transform((0.30, -0.20, 0.45), _TURN_LEFT)
    )
    mounting_error_m: float = 0.0
    mounting_error_rad: float = 0.0
    corners: str = "auto"

    @property
    def T_base_link_optical(self) -> Array:
        """Optical frame in the base, shape (4, 4) [m]."""
        return self.T_base_link_camera_link @ transform((0.0, 0.0, 0.0), _LINK_TO_OPTICAL)


@dataclass(frozen=True)
class QualitySettings:
    """Figures of eq (3) and of the approach-retry loop (M1.2).

    Attributes:
        alpha: Weight of the angle against the distance [1].
        distance_min_m: d_min, smallest safe distance of the camera from the marker plane [m].
        distance_max_m: d_max, largest useful distance [m].
        threshold: T_E [1].
        max_attempts: Estimates before the localisation gives up.
    """

    alpha: float = 0.5
    distance_min_m: float = 0.70
    distance_max_m: float = 3.0
    threshold: float = 0.85
    max_attempts: int = 8


@dataclass(frozen=True)
class Obstacle:
    """Something that stands in the cell: a box that nothing may touch or look through.

    Attributes:
        name: What it is, for messages.
        T_map_box: Its middle in the shop, shape (4, 4) [m].
        size_m: Its extents along its own axes [m].
    """

    name: str
    T_map_box: Array
    size_m: tuple[float, float, float]


@dataclass(frozen=True)
class TrackerSettings:
    """What the tracker needs to follow the scanner (M1.1, C-Track).

    The scanner carries targets on a ring about its view axis, through its origin: the tracker knows
    the scanner's pose while it sees enough of them. Range and cone are assumed figures.

    Attributes:
        range_min_m: Nearest distance of the scanner [m].
        range_max_m: Farthest distance of the scanner [m].
        cone_rad: Half angle of the cone of view about +x of the tracker [rad].
        targets: Number of targets on the ring, evenly spaced.
        ring_radius_m: Radius of the ring [m].
        targets_least: So many of them must be seen.
    """

    range_min_m: float = 1.0
    range_max_m: float = 6.0
    cone_rad: float = 0.87
    targets: int = 8
    ring_radius_m: float = 0.10
    targets_least: int = 3


@dataclass(frozen=True)
class CellConfig:
    """One work cell.

    Attributes:
        robot: Name of the arm model (a URDF in ``robot/models``) or path of a URDF.
        home_rad: Joint positions in which the base drives and the camera sees the fixture, shape
            (6,) [rad]: the arm is folded above the camera's view, the scanner 0.3 m to the left of
            the arm axis, in the branch that reaches most there.
        velocity_max_rad_s: Joint velocity limit of all joints [rad/s].
        acceleration_max_rad_s2: Joint acceleration limit of all joints [rad/s^2].
        T_base_link_arm_base: Arm on the base, shape (4, 4) [m].
        T_tool0_scanner: Scanner on the flange, shape (4, 4) [m]; +x is the view direction.
        scanner_radius_m: Radius of the sphere that stands for the scanner's body in collision
            checks [m].
        base_size_m: Length, width, height of the base (MiR100) [m].
        base_speed_m_s: Driving speed of the base [m/s].
        base_error_m: The base stops at most this far beside its goal [m].
        base_error_rad: ... and at most so much turned [rad].
        collision_margin_m: Distance kept between arm, scanner, base and part [m].
        T_map_tracker: Tracker in the shop, shape (4, 4) [m]; +x is its view direction.
        propose_tracker: Its place is not given: planning stations proposes one.
        T_map_work: Where the base drives to look for the part, shape (4, 4) [m].
        tracker: What the tracker sees.
        obstacles: What else stands in the shop.
        camera: The localisation camera.
        quality: Eq (3) and the approach-retry loop.
        settle_s: Time a station costs before scanning: settling and localisation [s].
    """

    robot: str = "ur5"
    home_rad: tuple[float, ...] = (1.4, -2.4, 2.1, 0.3, 1.4, -1.5707963)
    velocity_max_rad_s: float = float(np.pi)
    acceleration_max_rad_s2: float = 5.0
    T_base_link_arm_base: Array = field(default_factory=lambda: transform((0.0, 0.0, 1.0)))
    T_tool0_scanner: Array = field(
        default_factory=lambda: transform((0.0, 0.0, 0.15), _TOOL_TO_SCANNER)
    )
    scanner_radius_m: float = 0.10
    base_size_m: tuple[float, float, float] = (0.89, 0.58, 0.352)
    base_speed_m_s: float = 1.0
    base_error_m: float = 0.05
    base_error_rad: float = 0.017453292519943295
    collision_margin_m: float = 0.02
    T_map_tracker: Array = field(default_factory=lambda: transform((0.0, -3.5, 2.2), _TURN_LEFT))
    propose_tracker: bool = False
    tracker: TrackerSettings = field(default_factory=TrackerSettings)
    obstacles: tuple[Obstacle, ...] = ()
    T_map_work: Array = field(default_factory=lambda: planar(-0.3, -2.2, 0.25))
    camera: CameraConfig = field(default_factory=CameraConfig)
    quality: QualitySettings = field(default_factory=QualitySettings)
    settle_s: float = 5.0
