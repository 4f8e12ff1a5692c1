"""What an animation shows: the part with what has been seen of it, the base, the moving arm.

Everything is drawn by rays from one parallel view of the shop, map frame.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.scanner.tally import Tally
from skinplan.transforms import Array, apply, rotate
from skinplan.view import palette
from skinplan.view.arm_shapes import PEDESTAL_COLOUR, arm_pose, arm_shapes, pedestal_shape
from skinplan.view.camera import ParallelView, front_axes, view_of
from skinplan.view.motion import StationMotion
from skinplan.view.raster import Light, Raster, coloured, rasterise, smaller
from skinplan.view.stage import Stage
from skinplan.view.subject import Subject

UNSEEN: palette.Colour = (0.84, 0.85, 0.87)
SEEN: palette.Colour = (0.50, 0.76, 0.60)
IN_VIEW: palette.Colour = palette.FIELD
_SIDE_RAD, _RAISE_RAD = np.deg2rad(38.0), np.deg2rad(28.0)
_ROOM_M = 0.12
_MOST_ROWS_OF_WIDTH = 0.75
_OVERSAMPLE = 2
_SAMPLE_M = 0.012
_BOX_FACES = (
    (0, 3, 2), (0, 1, 3), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5),
    (2, 7, 6), (2, 3, 7), (0, 6, 4), (0, 2, 6), (1, 7, 3), (1, 5, 7),
)  # fmt: skip


class SeenSurface:
    """What the scanner has seen of a part up to now; the fixture hides nothing here.

    Attributes:
        share: Share of the area seen at least once [1].
    """

    def __init__(self, stage: Stage, scanner: ScannerModel) -> None:
        """Begins with nothing seen.

        Args:
            stage: The part; the faces of its display mesh are judged.
            scanner: Field of view, range and incidence limit.
        """
        mesh = stage.subject.mesh
        samples = sample_surface(mesh, _SAMPLE_M)
        self._tally = Tally(samples, RayCaster(mesh), scanner)
        self._weights = samples.weights
        self._nearest = cKDTree(samples.points).query(stage.display.mesh.centroids)[1]
        self._in_view = np.zeros(len(samples.points), dtype=bool)

    @property
    def share(self) -> float:
        """Share of the area seen at least once [1]."""
        seen = self._weights[self._tally.views > 0].sum()
        return float(seen / self._weights.sum())

    def look(self, T_workpiece_scanner: Array, now: bool) -> None:
        """Takes in what the scanner sees on its way.

        Args:
            T_workpiece_scanner: Poses of the scanner while it scans, shape (n, 4, 4) [m].
            now: Whether the last pose is the one of this moment: what it sees is in view. Else
                nothing is.
        """
        places, views = T_workpiece_scanner[:, :3, 3], T_workpiece_scanner[:, :3, 0]
        last = len(places) - 1 if now else len(places)
        if last > 0:
            self._tally.add_until(places[:last], views[:last], 1)
        before = self._tally.views.copy()
        if len(places) > last >= 0:
            self._tally.add(places[last:], views[last:])
        self._in_view = self._tally.views > before

    def face_colours(self) -> Array:
        """Returns the colours of the faces of the display mesh, shape (f, 3)."""
        codes = np.where(self._in_view, 2, self._tally.views > 0)
        return np.array([UNSEEN, SEEN, IN_VIEW])[codes[self._nearest]]


class AnimationView:
    """Pictures of the arm at work from one place.

    Attributes:
        view: The view of the pictures, map frame.
    """

    def __init__(self, stage: Stage, motions: Sequence[StationMotion], width_px: int) -> None:
        """Chooses the view so that all motions are in it.

        Args:
            stage: The part; the subject has a station plan.
            motions: What the arm does.
            width_px: Largest width of the pictures [px].
        """
        self._stage, self._shapes = stage, arm_shapes(stage.subject.cell)
        self._part = _moved(stage.display.mesh, stage.subject.T_map_workpiece)
        right, toward = _axes(stage)
        places = [self._part.vertices]
        for motion in motions:
            T_map_arm = arm_pose(stage.subject, motion.number)
            ends = motion.arm.links(motion.positions)[:, :, :3, 3].reshape(-1, 3)
            scanner = motion.arm.forward_scanner(motion.positions)[:, :3, 3]
            bodies = apply(T_map_arm, np.concatenate([ends, scanner]))
            room = np.vstack([bodies - _ROOM_M, bodies + _ROOM_M])
            places += [room, self._base(motion.number)[0].vertices]
        shown = np.concatenate(places)
        view = view_of(shown, right, toward, width_px)
        most = _MOST_ROWS_OF_WIDTH * width_px
        if view.rows > most:
            view = view_of(shown, right, toward, int(width_px * most / view.rows))
        self.view = view
        self._fine = view.finer(_OVERSAMPLE)
        self._light = Light.of(right, toward)
        self._standing: dict[int, tuple[Raster, SurfaceMesh, Array]] = {}

    def image(self, motion: StationMotion, q: Array, face_colours: Array) -> NDArray[np.uint8]:
        """Draws the arm at a station.

        Args:
            motion: Whose station and arm.
            q: Joint positions, shape (6,) [rad].
            face_colours: Of the part's display mesh, shape (f, 3).

        Returns:
            Red, green, blue, shape (rows, columns, 3); white where there is nothing.
        """
        raster, mesh, standing = self._still(motion.number)
        colours = np.concatenate([face_colours, standing])
        image = coloured(raster, mesh, colours, self._light)
        self._draw_arm(motion, q, raster, image)
        small = smaller(image, _OVERSAMPLE)
        opacity = small[..., 3:].astype(np.float32) / 255.0
        return np.rint(small[..., :3] * opacity + 255.0 * (1.0 - opacity)).astype(np.uint8)

    def _still(self, number: int) -> tuple[Raster, SurfaceMesh, Array]:
        """What does not move at a station: raster, mesh (the part first), colours of the rest."""
        if number not in self._standing:
            base, colours = self._base(number)
            mesh = _joined([self._part, base])
            self._standing[number] = (rasterise(mesh, self._fine), mesh, colours)
        return self._standing[number]

    def _base(self, number: int) -> tuple[SurfaceMesh, Array]:
        """The base with the arm's pedestal at a station, map frame, and colours of its faces."""
        subject = self._stage.subject
        assert subject.station_plan is not None
        length, width, height = subject.cell.base_size_m
        signs = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
        box = SurfaceMesh(signs * (length, width, height), np.array(_BOX_FACES))
        pedestal = pedestal_shape(subject.cell)
        colours = np.repeat(
            [palette.series(number), PEDESTAL_COLOUR], [len(box.faces), len(pedestal.faces)], axis=0
        )
        pose = subject.station_plan.stations[number].T_map_base_link
        return _moved(_joined([box, pedestal]), pose), colours

    def _draw_arm(
        self, motion: StationMotion, q: Array, still: Raster, image: NDArray[np.uint8]
    ) -> None:
        """Draws the arm into an image of what stands still, where it is nearer."""
        T_map_arm = arm_pose(self._stage.subject, motion.number)
        frames = T_map_arm @ motion.arm.links(q[None])[0]
        arm = _joined([_moved(shape.mesh, frames[shape.joint]) for shape in self._shapes])
        colours = np.repeat(
            [shape.colour for shape in self._shapes],
            [len(shape.mesh.faces) for shape in self._shapes],
            axis=0,
        )
        window, rows, columns = _window(self._fine, arm)
        raster = rasterise(arm, window)
        nearer = raster.depth > still.depth[rows, columns]
        drawn = coloured(raster, arm, colours, self._light)
        image[rows, columns][nearer] = drawn[nearer]


def shown_colours(subject: Subject) -> tuple[palette.Colour, ...]:
    """Returns the colours of all that is drawn, before shading."""
    count = 0 if subject.station_plan is None else len(subject.station_plan.stations)
    bases = (palette.series(number) for number in range(count))
    arm = (shape.colour for shape in arm_shapes(subject.cell))
    return tuple(dict.fromkeys((UNSEEN, SEEN, IN_VIEW, PEDESTAL_COLOUR, *arm, *bases)))


def _axes(stage: Stage) -> tuple[Array, Array]:
    """Right and toward of the view: from the side and above, as a person stands there."""
    front = rotate(stage.subject.T_map_workpiece, np.stack(front_axes(stage.subject.mesh)))[1]
    level = np.array([front[0], front[1], 0.0])
    # A part that lies has no side to the front.
    length = float(np.linalg.norm(level))
    level = level / length if length > 0.05 else np.array([0.0, -1.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    side = np.cross(up, level)
    flat = np.cos(_SIDE_RAD) * level + np.sin(_SIDE_RAD) * side
    toward = np.cos(_RAISE_RAD) * flat + np.sin(_RAISE_RAD) * up
    right = np.cross(up, toward)
    return right / np.linalg.norm(right), toward


def _window(view: ParallelView, mesh: SurfaceMesh) -> tuple[ParallelView, slice, slice]:
    """The part of a view that a mesh is in, and its rows and columns."""
    cells = view.pixels(mesh.vertices)
    low = np.clip(cells.min(axis=0) - 1, 0, (view.rows - 1, view.columns - 1))
    high = np.clip(cells.max(axis=0) + 2, low + 1, (view.rows, view.columns))
    rows, columns = slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))
    window = replace(
        view,
        left=view.left + columns.start * view.pixel_m,
        bottom=view.bottom + (view.rows - rows.stop) * view.pixel_m,
        columns=columns.stop - columns.start,
        rows=rows.stop - rows.start,
    )
    return window, rows, columns


def _moved(mesh: SurfaceMesh, T_a_b: Array) -> SurfaceMesh:
    return SurfaceMesh(apply(T_a_b, mesh.vertices), mesh.faces)


def _joined(meshes: Sequence[SurfaceMesh]) -> SurfaceMesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return SurfaceMesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))
