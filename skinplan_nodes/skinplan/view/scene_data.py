"""The plan as arrays for a 3-D scene: no viewer is needed to make them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.topology import compact
from skinplan.scan_path.model import FEATURE, ROW, ScanPath
from skinplan.scanner.model import Coverage, ScannerModel
from skinplan.transforms import Array, transform
from skinplan.view import palette
from skinplan.view.display_mesh import DisplayMesh, refined, thinned
from skinplan.view.face_classes import FaceClasses, coverage_classes, region_classes
from skinplan.view.path_pictures import rows_of
from skinplan.view.subject import Subject

MOST_FACES = 300_000
_ARROW_M = 0.08
_CYLINDER_SIDES = 48


@dataclass(frozen=True, eq=False)
class Piece:
    """The part of a mesh that has one colour.

    Attributes:
        name: What the colour means.
        mesh: The faces, workpiece frame.
        colour: Red, green, blue in [0, 1].
    """

    name: str
    mesh: SurfaceMesh
    colour: palette.Colour


@dataclass(frozen=True, eq=False)
class SceneData:
    """What a 3-D scene of a subject shows, workpiece frame.

    Attributes:
        subject: The subject.
        most_faces: The mesh is made smaller for the eye when it has more faces.
    """

    subject: Subject
    most_faces: int = MOST_FACES

    @cached_property
    def display(self) -> DisplayMesh:
        """The mesh that is shown."""
        mesh = self.subject.mesh
        if len(mesh.faces) > self.most_faces:
            return thinned(mesh, self.most_faces)
        return refined(mesh, most=self.most_faces)

    @property
    def is_thinned(self) -> bool:
        """Whether the mesh shown is coarser than the part's."""
        return len(self.subject.mesh.faces) > self.most_faces

    @cached_property
    def colourings(self) -> dict[str, tuple[Piece, ...]]:
        """The ways to colour the part: name and pieces, none of them empty."""
        subject = self.subject
        regions = region_classes(subject.mesh, subject.segmentation).of(self.display)
        found = {"regions": self._pieces(regions)}
        for name, coverage in self._coverages():
            classes = coverage_classes(coverage, self.display)
            found[name] = self._pieces(classes)
        return found

    def _coverages(self) -> list[tuple[str, Coverage]]:
        given = (
            ("coverage", self.subject.coverage),
            ("coverage by row cutting alone", self.subject.rows_only),
        )
        return [(name, coverage) for name, coverage in given if coverage is not None]

    def _pieces(self, classes: FaceClasses) -> tuple[Piece, ...]:
        pieces = []
        for number, (name, colour) in enumerate(zip(classes.names, classes.colours, strict=True)):
            inside: NDArray[np.bool_] = classes.codes == number
            if inside.any():
                red, green, blue = (float(channel) for channel in colour)
                pieces.append(Piece(name, compact(self.display.mesh, inside), (red, green, blue)))
        return tuple(pieces)


def arrows(path: ScanPath, kind: int) -> Array:
    """Returns start and end of an arrow along each view direction, shape (n, 2, 3) [m].

    Args:
        path: The path.
        kind: ROW or FEATURE.
    """
    chosen = path.kinds == kind
    start = path.positions[chosen]
    return np.stack([start, start + _ARROW_M * path.directions[chosen]], axis=1)


def row_lines(path: ScanPath) -> Array:
    """Returns the ends of the lines between neighbours on rows, shape (m, 2, 3) [m]."""
    lines = [
        np.stack([path.positions[members[:-1]], path.positions[members[1:]]], axis=1)
        for _, members in rows_of(path)
    ]
    return np.concatenate([np.zeros((0, 2, 3)), *lines])


def field_mesh(scanner: ScannerModel) -> SurfaceMesh:
    """Makes the field of view (M2.1), a closed cylinder about +x of the scanner frame."""
    angles = np.arange(_CYLINDER_SIDES) * 2.0 * np.pi / _CYLINDER_SIDES
    ring = scanner.field_radius_m * np.stack(
        [np.zeros_like(angles), np.cos(angles), np.sin(angles)], axis=1
    )
    ends = (scanner.range_min_m, scanner.range_max_m)
    middles = [[ends[0], 0.0, 0.0], [ends[1], 0.0, 0.0]]
    vertices = np.concatenate([*(ring + (x, 0.0, 0.0) for x in ends), middles])
    here = np.arange(_CYLINDER_SIDES)
    after = (here + 1) % _CYLINDER_SIDES
    far, near_middle, far_middle = _CYLINDER_SIDES, 2 * _CYLINDER_SIDES, 2 * _CYLINDER_SIDES + 1
    faces = [
        np.stack([here, after, after + far], axis=1),
        np.stack([here, after + far, here + far], axis=1),
        np.stack([after, here, np.full_like(here, near_middle)], axis=1),
        np.stack([here + far, after + far, np.full_like(here, far_middle)], axis=1),
    ]
    return SurfaceMesh(vertices, np.concatenate(faces))


def scanner_pose(path: ScanPath, point: int) -> Array:
    """Returns the scanner at a point, shape (4, 4) [m], workpiece frame; +x is the view direction.

    The roll about the view direction is any: the field of view is round.
    """
    ahead = path.directions[point]
    helper = np.eye(3)[np.argmin(np.abs(ahead))]
    side = np.cross(ahead, helper)
    side /= np.linalg.norm(side)
    return transform(path.positions[point], np.stack([ahead, side, np.cross(ahead, side)], axis=1))


def point_sentence(subject: Subject, point: int) -> str:
    """Returns what there is to say about a scan path point."""
    path = subject.path
    if path is None or not 0 <= point < len(path):
        return "no such point"
    group = "row" if path.kinds[point] == ROW else "region"
    kind = "feature point" if path.kinds[point] == FEATURE else "row point"
    x, y, z = path.positions[point]
    told = f"point {point}: {kind}, {group} {path.groups[point]}, at {x:.3f}, {y:.3f}, {z:.3f} m"
    if subject.station_plan is None:
        return told
    station = int(subject.station_of_points()[point])
    if station >= 0:
        return f"{told}, station {subject.station_plan.stations[station].id}"
    reasons = [entry.reason for entry in subject.skipped if entry.point == point]
    return f"{told}, not scanned" + (f": {reasons[0]}" if reasons else "")
