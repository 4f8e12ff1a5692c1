"""Markers for RViz and Foxglove: part, scan path, stations, viewing volumes, coverage."""

from collections.abc import Iterable, Sequence

import numpy as np
from geometry_msgs.msg import Point
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from skinplan.mesh.model import SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.scan_path.model import ROW, ScanPath
from skinplan.stations.model import StationPlan
from skinplan.transforms import Array
from skinplan_nodes.conversions import pose_to_msg

_GREY = (0.62, 0.65, 0.70, 1.0)
_ROW = (0.10, 0.45, 0.85, 1.0)
_FEATURE = (0.90, 0.45, 0.10, 1.0)
_STATION = (0.25, 0.65, 0.35, 0.8)
_FRUSTUM = (0.10, 0.45, 0.85, 0.35)
_TEXT = (1.0, 1.0, 1.0, 1.0)
# Seen by none, one, two ... views; the last one holds for more.
_VIEWS = ((0.80, 0.10, 0.10, 1.0), (0.95, 0.60, 0.10, 1.0), (0.95, 0.90, 0.20, 1.0),
          (0.20, 0.70, 0.30, 1.0))  # fmt: skip
_CORNERS = 12


def part_markers(mesh: SurfaceMesh) -> MarkerArray:
    """The part's surface, in the workpiece frame."""
    marker = _marker("workpiece", "part", Marker.TRIANGLE_LIST, _GREY, (1.0, 1.0, 1.0))
    marker.points = _points(mesh.vertices[mesh.faces].reshape(-1, 3))
    return MarkerArray(markers=[_clear(), marker])


def path_markers(path: ScanPath) -> MarkerArray:
    """The scan path: points with view directions, rows as lines, in the workpiece frame."""
    markers = [_clear()]
    ends = path.positions + 0.05 * path.directions
    for number, (kind, colour) in enumerate((("rows", _ROW), ("features", _FEATURE))):
        mine = (path.kinds == ROW) == (kind == "rows")
        dots = _marker("workpiece", kind, Marker.SPHERE_LIST, colour, (0.012,) * 3, number)
        dots.points = _points(path.positions[mine])
        looks = _marker("workpiece", kind, Marker.LINE_LIST, colour, (0.003, 0.0, 0.0), number + 2)
        pairs = np.stack([path.positions[mine], ends[mine]], axis=1)
        looks.points = _points(pairs.reshape(-1, 3))
        markers += [dots, looks]
    for group in np.unique(path.groups[path.kinds == ROW]):
        row = path.positions[(path.kinds == ROW) & (path.groups == group)]
        if len(row) > 1:
            line = _marker(
                "workpiece", "row lines", Marker.LINE_STRIP, _ROW, (0.004, 0.0, 0.0), int(group)
            )
            line.points = _points(row)
            markers.append(line)
    return MarkerArray(markers=[m for m in markers if m.action != Marker.ADD or m.points])


def frustum_markers(path: ScanPath, settings: ScanSettings) -> MarkerArray:
    """What the scanner takes in at each point: from its nearest to its farthest distance."""
    marker = _marker("workpiece", "frusta", Marker.LINE_LIST, _FRUSTUM, (0.0015, 0.0, 0.0))
    pieces = [
        _volume(position, direction, settings)
        for position, direction in zip(path.positions, path.directions, strict=True)
    ]
    marker.points = _points(np.concatenate(pieces) if pieces else np.empty((0, 3)))
    return MarkerArray(markers=[_clear(), *([marker] if pieces else [])])


def station_markers(plan: StationPlan) -> MarkerArray:
    """Where the base stands, with numbers; the tracker where its place is known."""
    markers = [_clear()]
    for number, station in enumerate(plan.stations):
        body = _marker("map", "stations", Marker.CUBE, _STATION, (0.89, 0.58, 0.05), number)
        body.pose = pose_to_msg(station.T_map_base_link)
        heading = _marker("map", "headings", Marker.ARROW, _STATION, (0.5, 0.04, 0.04), number)
        heading.pose = body.pose
        label = _marker("map", "numbers", Marker.TEXT_VIEW_FACING, _TEXT, (0.0, 0.0, 0.2), number)
        label.pose = pose_to_msg(station.T_map_base_link)
        label.pose.position.z += 0.4
        label.text = f"station {number + 1}: {len(station.points)} points"
        markers += [body, heading, label]
    if plan.T_map_tracker is not None:
        tracker = _marker("map", "tracker", Marker.CUBE, _FEATURE, (0.15, 1.0, 0.15))
        tracker.pose = pose_to_msg(plan.T_map_tracker)
        markers.append(tracker)
    return MarkerArray(markers=markers)


def coverage_markers(places: Array, views: NDArray[np.int64]) -> MarkerArray:
    """By how many views of the scan path each place is seen.

    Args:
        places: Surface samples in the workpiece frame, shape (s, 3) [m].
        views: Views that see each, shape (s,).
    """
    marker = _marker("workpiece", "views", Marker.POINTS, _GREY, (0.008, 0.008, 0.0))
    marker.points = _points(places)
    colours = [_colour(colour) for colour in _VIEWS]
    marker.colors = [colours[min(int(count), len(colours) - 1)] for count in views]
    return MarkerArray(markers=[_clear(), *([marker] if len(places) else [])])


def progress_markers(area_ratio: float, points: int) -> MarkerArray:
    """What was measured so far, as text above the part."""
    label = _marker("workpiece", "progress", Marker.TEXT_VIEW_FACING, _TEXT, (0.0, 0.0, 0.12))
    label.pose.position.z = 0.5
    share = "not located yet" if np.isnan(area_ratio) else f"{area_ratio:.1%} of the area"
    label.text = f"{share}, {points} points"
    return MarkerArray(markers=[label])


def _volume(position: Array, direction: Array, settings: ScanSettings) -> Array:
    """Lines of the cylinder or cone about the view axis, shape (n, 3), pairs of ends [m]."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    across = np.cross(direction, helper)
    across /= np.linalg.norm(across)
    up = np.cross(direction, across)
    angles = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
    ring = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * up
    near_m, far_m = settings.range_min_m, settings.range_max_m
    radius = np.array([settings.field_radius_m, settings.field_radius_m])
    if settings.field_of_view == "cone":
        radius = settings.field_radius_m * np.array([near_m, far_m]) / settings.standoff_m
    near = position + near_m * direction + radius[0] * ring
    far = position + far_m * direction + radius[1] * ring
    rings = [np.stack([ends, np.roll(ends, -1, axis=0)], axis=1) for ends in (near, far)]
    sides = np.stack([near, far], axis=1)[:: _CORNERS // 4]
    return np.concatenate([*rings, sides]).reshape(-1, 3)


def _marker(
    frame: str,
    namespace: str,
    kind: int,
    colour: Sequence[float],
    scale: Sequence[float],
    number: int = 0,
) -> Marker:
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, frame_locked=True)
    marker.header.frame_id = frame
    marker.color = _colour(colour)
    marker.scale.x, marker.scale.y, marker.scale.z = (float(value) for value in scale)
    marker.pose.orientation.w = 1.0
    return marker


def _clear() -> Marker:
    return Marker(action=Marker.DELETEALL)


def _points(places: Iterable[Sequence[float]]) -> list[Point]:
    return [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in places]


def _colour(rgba: Sequence[float]) -> ColorRGBA:
    r, g, b, a = rgba
    return ColorRGBA(r=r, g=g, b=b, a=a)
