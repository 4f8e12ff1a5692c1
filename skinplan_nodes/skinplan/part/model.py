"""What is known about a part before it is measured: mesh, fixture, scan settings, place."""

from dataclasses import dataclass, field
from pathlib import Path

from skinplan.part.inspection_plan import InspectionPlan
from skinplan.part.inspection_points import InspectionPoints
from skinplan.part.recognition_plan import RecognitionPlan
from skinplan.transforms import Array


@dataclass(frozen=True)
class Marker:
    """An ArUco marker on the fixture.

    Attributes:
        id: Number in the fixture's dictionary.
        size_m: Side of the black square [m].
        T_fixture_marker: Marker frame in the fixture, shape (4, 4) [m]; marker x to the right, y
            up, z out of the print.
    """

    id: int
    size_m: float
    T_fixture_marker: Array


@dataclass(frozen=True)
class Fixture:
    """What holds the part and carries the markers (M1.1, frames F and QR).

    Attributes:
        dictionary: Name of the ArUco dictionary, as OpenCV writes it (``DICT_5X5_100``); empty
            without markers.
        T_workpiece_fixture: Fixture frame in the workpiece, shape (4, 4) [m].
        markers: Markers, ids unique; empty = there are none, the part is located by its shape.
    """

    dictionary: str
    T_workpiece_fixture: Array
    markers: tuple[Marker, ...]

    def T_workpiece_marker(self, marker_id: int) -> Array:
        """Returns the marker's frame in the workpiece, shape (4, 4) [m]; KeyError without it."""
        for marker in self.markers:
            if marker.id == marker_id:
                return self.T_workpiece_fixture @ marker.T_fixture_marker
        raise KeyError(marker_id)


@dataclass(frozen=True)
class ScanSettings:
    """How the part is scanned (M2.1, M2.2; defaults are the values of scene 4).

    Attributes:
        strategy: Name of the scan path strategy.
        station_strategy: Name of the station strategy.
        order_strategy: Name of the strategy for the order of visit.
        sensitivity: Exponent k of eq (4) [1], >= 0.
        overlap_ratio: h of eq (5) [1], in [0, 1).
        field_radius_m: r_f, radius of the field of view [m].
        standoff_m: d_best, working distance [m].
        range_min_m: d_min of the scanner [m].
        range_max_m: d_max of the scanner [m].
        incidence_max_rad: Largest angle between the view axis and the inward surface normal at
            which a facet counts as seen.
        row_direction: Unit vector of the rows in the workpiece frame; None = found (the one with
            the least path).
        tilt_max_rad: Largest tilt of a view direction for reach or clearance.
        clearance_m: Least distance between the scanner's origin and the part [m].
        tcp_speed_m_s: Speed limit of the scanner while scanning [m/s].
        timing: Name of the timing: ``toppra`` (quickest) or ``bezier`` (bounded jerk).
        frame_rate_hz: Frames that the scanner takes in a second [Hz].
        tour_effort_s: Order strategy ``tour``: about how long it searches at each station [s]. It
            is counted in moves looked at, so the plan does not depend on the machine.
        field_of_view: ``cylinder`` (the paper's) or ``cone`` (that it simplifies; r_f is the
            radius of its section at d_min).
        least_views: Number of views that each place of the surface should be seen by.
        incidence_margin_rad: Strategy ``coverage`` counts on views only so far inside the incidence
            limit [rad] ...
        field_margin_m: ... and so far inside field of view and range [m].
        optimise_passes: Whether depth and angles of the passes are optimised (T S3) before stations
            and trajectories are planned; a re-scan is left as it is.
        patch_angle_rad: Strategy ``patches``: a patch holds the facets whose normals are at most so
            far from its mean normal [rad].
        footprint_m: Strategy ``patches``: width of the strip that one row of the scanner or tool
            treats [m]; None = the whole field of view, twice r_f.
        tool_tilt_rad: Strategy ``patches``: the scanner or tool leans so far from the normal of the
            patch toward the direction of the rows [rad].
        merge_gap_m: Strategy ``patches``: rows of patches and parts at most so far apart are made
            one where that saves turns [m]; 0 = each patch keeps its own rows.
    """

    strategy: str = "coverage"
    station_strategy: str = "reach"
    order_strategy: str = "tour"
    sensitivity: float = 2.0
    overlap_ratio: float = 0.6
    field_radius_m: float = 0.2
    standoff_m: float = 0.3
    range_min_m: float = 0.2
    range_max_m: float = 0.4
    incidence_max_rad: float = 1.0471975511965976
    row_direction: tuple[float, float, float] | None = None
    tilt_max_rad: float = 0.2617993877991494
    clearance_m: float = 0.15
    tcp_speed_m_s: float = 0.2
    timing: str = "toppra"
    frame_rate_hz: float = 10.0
    tour_effort_s: float = 1.5
    field_of_view: str = "cylinder"
    least_views: int = 3
    incidence_margin_rad: float = 0.05235987755982988
    field_margin_m: float = 0.005
    optimise_passes: bool = False
    patch_angle_rad: float = 0.4363323129985824
    footprint_m: float | None = None
    tool_tilt_rad: float = 0.0
    merge_gap_m: float = 0.2

    @property
    def row_interval_m(self) -> float:
        """d_interval of eq (5): (1 - h) r_f [m]."""
        return (1.0 - self.overlap_ratio) * self.field_radius_m


@dataclass(frozen=True)
class Part:
    """A part to be measured.

    Attributes:
        id: Name of the part, [A-Za-z0-9_.-].
        mesh_path: Mesh file.
        unit: Unit of the mesh file: ``m``, ``mm``, ``cm`` or ``inch``.
        mesh_sha256: Hash of the mesh file's bytes, lower-case hex.
        fixture: Fixture and markers.
        T_map_workpiece: Nominal place in the shop, shape (4, 4) [m]: where it should stand, not
            where it stands.
        scan: Scan settings.
        source: The part file that it came from; None when it was made from a bare mesh.
        points: Points that someone wants measured; None = nobody says which.
        inspection: What it is judged by.
        recognition: Whether the cell makes sure that it is this part.
    """

    id: str
    mesh_path: Path
    unit: str
    mesh_sha256: str
    fixture: Fixture
    T_map_workpiece: Array
    scan: ScanSettings = field(default_factory=ScanSettings)
    source: Path | None = None
    points: InspectionPoints | None = None
    inspection: InspectionPlan = field(default_factory=InspectionPlan)
    recognition: RecognitionPlan = field(default_factory=RecognitionPlan)
