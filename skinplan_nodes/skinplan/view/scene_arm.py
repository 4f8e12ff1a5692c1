"""The arm at a station and the tracker that follows it, in a viser scene."""

from typing import Any

import numpy as np

from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, apply, inverse, quaternion
from skinplan.view import palette
from skinplan.view.arm_shapes import (
    PEDESTAL_COLOUR,
    Posture,
    arm_pose,
    arm_shapes,
    pedestal_shape,
    posture,
)
from skinplan.view.subject import Subject
from skinplan.view.tracker_marks import COLOUR as TRACKER_COLOUR

_SEEN: palette.Colour = (0.00, 0.62, 0.45)
_UNKNOWN: palette.Colour = palette.FAINT
_SPOKES = 24
_BODY_M = (0.25, 0.9, 0.2)  # a box for the tracker
_NEAR_CONE_M = 0.8


class ArmView:
    """The arm as nodes of a scene, one frame per joint.

    Attributes:
        base: The frame of the arm base below ``/``, in the shop.
        joints: Frames of the joints below it, number 0 is the arm base itself.
        scanner: The frame of the scanner below the last joint.
        sight: The line from the tracker to the scanner.
        posture: What is shown; None before the first `place`.
    """

    def __init__(self, scene: Any, subject: Subject) -> None:
        """Makes the nodes.

        Args:
            scene: Of a ``viser.ViserServer``.
            subject: Has a path and a station plan.
        """
        self._subject, self._arm = subject, ArmModel.load(subject.cell)
        self.posture: Posture | None = None
        self.base = scene.add_frame("/arm", axes_length=0.2, axes_radius=0.006)
        self.joints = [
            scene.add_frame(f"/arm/joint_{number}", show_axes=False) for number in range(7)
        ]
        shapes = arm_shapes(subject.cell)
        for number, shape in enumerate(shapes):
            scene.add_mesh_simple(
                f"/arm/joint_{shape.joint}/{shape.name}_{number}", shape.mesh.vertices,
                shape.mesh.faces, color=_bytes(shape.colour), cast_shadow=False,
                receive_shadow=False,
            )  # fmt: skip
        pedestal = pedestal_shape(subject.cell)
        T_arm_base_link = inverse(subject.cell.T_base_link_arm_base)
        scene.add_mesh_simple(
            "/arm/pedestal", apply(T_arm_base_link, pedestal.vertices), pedestal.faces,
            color=_bytes(PEDESTAL_COLOUR), cast_shadow=False, receive_shadow=False,
        )  # fmt: skip
        zero = np.zeros((1, 6))
        T_6_scanner = inverse(self._arm.links(zero)[0, 6]) @ self._arm.forward_scanner(zero)[0]
        self.scanner = scene.add_frame(
            "/arm/joint_6/scanner", axes_length=0.18, axes_radius=0.006, **_placed(T_6_scanner)
        )
        self.sight = scene.add_line_segments(
            "/sight", np.zeros((1, 2, 3), dtype=np.float32), _bytes(_UNKNOWN), thickness=0.006
        )

    def place(self, station: int, point: int) -> Posture:
        """Puts the arm at a station, with the scanner at a point or, if it can't, at home.

        Args:
            station: Its place in the order of visit.
            point: Number of the scan path point.
        """
        shown = posture(self._subject, station, point)
        self._stand(station, shown)
        return shown

    def move(self, station: int, q: Array) -> None:
        """Puts the arm at a station into joint positions.

        Args:
            station: Its place in the order of visit.
            q: Joint positions, shape (6,) [rad].
        """
        self._stand(station, Posture(q, True, "on its way"))

    def _stand(self, station: int, shown: Posture) -> None:
        T_map_arm = arm_pose(self._subject, station)
        _move(self.base, T_map_arm)
        frames = self._arm.links(shown.q[None])[0]
        for handle, pose in zip(self.joints, frames, strict=True):
            _move(handle, pose)
        scanner = (T_map_arm @ self._arm.forward_scanner(shown.q[None])[0])[:3, 3]
        ends = np.array([[self._subject.T_map_tracker[:3, 3], scanner]], dtype=np.float32)
        self.sight.points = ends
        colour = np.array(_bytes(_SEEN if shown.seen else _UNKNOWN), dtype=np.uint8)
        self.sight.colors = np.broadcast_to(colour, (1, 2, 3))
        self.posture = shown


def add_tracker(scene: Any, subject: Subject) -> tuple[list[Any], list[Any]]:
    """Adds the tracker with a short piece of its cone, and its whole field of view.

    Args:
        scene: Of a ``viser.ViserServer``.
        subject: Has a cell.

    Returns:
        Handles of the tracker, and of the field.
    """
    cell = subject.cell
    frame = scene.add_frame(
        "/tracker", axes_length=0.4, axes_radius=0.012, **_placed(subject.T_map_tracker)
    )
    scene.add_box(
        "/tracker/body", color=_bytes(TRACKER_COLOUR), dimensions=_BODY_M,
        position=(-0.5 * _BODY_M[0], 0.0, 0.0), opacity=0.9,
    )  # fmt: skip
    scene.add_line_segments(
        "/tracker/cone",
        cone_lines(cell, 0.0, _NEAR_CONE_M),
        _bytes(TRACKER_COLOUR),
        thickness=0.006,
    )
    scene.add_label("/tracker/label", "tracker", position=(0.0, 0.0, 0.25))
    far = cone_lines(cell, cell.tracker.range_min_m, cell.tracker.range_max_m)
    whole = scene.add_line_segments(
        "/tracker/field", far, _bytes(TRACKER_COLOUR), thickness=0.006, visible=False
    )
    return [frame], [whole]


def cone_lines(cell: CellConfig, near_m: float, far_m: float) -> Array:
    """Returns the tracker's cone between two distances as lines, shape (m, 2, 3) [m].

    Args:
        cell: The cell.
        near_m: Distance of its beginning from the tracker [m].
        far_m: Distance of its end [m].

    Returns:
        Spokes and the two rings, tracker frame: +x is the view direction.
    """
    turns = 2.0 * np.pi * np.arange(_SPOKES) / _SPOKES
    sine, cosine = np.sin(cell.tracker.cone_rad), np.cos(cell.tracker.cone_rad)
    rim = np.stack([np.full(_SPOKES, cosine), sine * np.cos(turns), sine * np.sin(turns)], axis=1)
    after = np.roll(rim, -1, axis=0)
    spokes = np.stack([near_m * rim, far_m * rim], axis=1)[::3]
    rings = [np.stack([d * rim, d * after], axis=1) for d in (near_m, far_m) if d > 0.0]
    return np.concatenate([spokes, *rings])


def _placed(T_a_b: Array) -> dict[str, Array]:
    # viser turns w, x, y, z; ours is x, y, z, w.
    return {"wxyz": np.roll(quaternion(T_a_b), 1), "position": T_a_b[:3, 3]}


def _move(handle: Any, T_a_b: Array) -> None:
    placed = _placed(T_a_b)
    handle.wxyz, handle.position = placed["wxyz"], placed["position"]


def _bytes(colour: palette.Colour) -> tuple[int, int, int]:
    red, green, blue = (round(255 * channel) for channel in colour)
    return red, green, blue
