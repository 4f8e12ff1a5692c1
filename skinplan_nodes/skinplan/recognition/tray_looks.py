"""How the types of a tray would look at a place: outlines through the camera model (R 1)."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
import trimesh

from skinplan.recognition.tray.layout import resting
from skinplan.recognition.tray_image import Blob, blobs_of, opened
from skinplan.recognition.tray_view import TrayView
from skinplan.transforms import Array, apply

_SHIFT_BITS = 4
# Free pixels around a drawn type.
_RIM = 3
# Two rounds bring the outline's centre to that of the blob within a few tenths of a millimetre.
_PLACE_ROUNDS = 2
# A type that is farther off than this at the first look is not looked at again.
_HOPELESS = 0.4
# The rectangle around a stubby part may lie across it, seen from the side.
_STUBBY = 1.5
_MOST_TURN_RAD = 0.5


@dataclass(frozen=True, eq=False)
class Look:
    """A type in one of its poses: how far its figures are from those of an outline.

    ``apart`` is the share of both outlines that is in one of them only.
    """

    name: str
    deviation: float
    apart: float
    place: Array
    outside_m: float


class Looks:
    """Puts types where an outline is, and looks at them through the camera."""

    def __init__(
        self, view: TrayView, models: Mapping[str, trimesh.Trimesh], slack_m: float, open_m: float
    ) -> None:
        """Keeps the types.

        Args:
            view: Camera and tray.
            models: Meshes of the types, lying as they are put on the tray (z up) [m].
            slack_m: Sides may differ by so much, outlines all round by half of it, before it counts
                [m].
            open_m: Opening of the images: narrow sides of parts fall to it here, too [m].
        """
        self._view, self._models = view, models
        self._slack, self._open = slack_m, open_m

    def of(self, blob: Blob) -> list[Look]:
        """Returns the looks of all types about as large as an outline."""
        return [
            look
            for name, mesh in self._models.items()
            if self._may_be(mesh, blob)
            for look in self._of_type(name, mesh, blob)
        ]

    def _may_be(self, mesh: trimesh.Trimesh, blob: Blob) -> bool:
        """A quick sieve: perspective makes a part at most about its height longer or wider."""
        low = np.sort(mesh.extents[:2]) - mesh.extents[2] - self._slack
        high = np.sort(mesh.extents[:2]) + 1.5 * mesh.extents[2] + self._slack
        sides = np.array([blob.size_m[1], blob.size_m[0]])
        # The box of a mesh may be askew to its rectangle of least area.
        return bool(np.all(sides >= 0.8 * low) and np.all(sides <= 1.2 * high))

    def _of_type(self, name: str, mesh: trimesh.Trimesh, blob: Blob) -> list[Look]:
        """The type at the place of an outline: both ways up, both ways round."""
        stubby = min(blob.aspect, float(np.ptp(mesh.extents[:2]) / mesh.extents[:2].min() + 1.0))
        quarters = (0, 1, 2, 3) if stubby < _STUBBY else (0, 2)
        looks = [
            self._look(name, mesh, blob, blob.heading_rad + quarter * np.pi / 2.0, upside_down)
            for upside_down in (False, True)
            for quarter in quarters
        ]
        return [look for look in looks if look is not None]

    def _look(
        self, name: str, mesh: trimesh.Trimesh, blob: Blob, heading: float, upside_down: bool
    ) -> Look | None:
        """Moves a type until its outline has centre and direction of the blob."""
        rest = resting(mesh, 0.0, upside_down)
        turn = heading - _long_side(apply(rest, mesh.vertices)[:, :2])
        middle, rounds = blob.centre, 0
        while True:
            pose = resting(mesh, turn, upside_down)
            pose[:2, 3] += middle
            outlines = self._outlines(mesh, pose)
            if not outlines:
                return None
            seen = min(outlines, key=lambda each: self._deviation(blob, each))
            deviation = self._deviation(blob, seen)
            if rounds == _PLACE_ROUNDS or deviation > _HOPELESS:
                break
            rounds += 1
            middle = middle + blob.centre - seen.centre
            askew = (blob.heading_rad - seen.heading_rad + np.pi / 2.0) % np.pi - np.pi / 2.0
            turn += askew if abs(askew) < _MOST_TURN_RAD else 0.0
        points = apply(pose, mesh.vertices)[:, :2]
        low, high = points.min(axis=0), points.max(axis=0)
        over = float(np.maximum(-low, high - np.array(self._view.size_m)).max())
        return Look(name, deviation, self._apart(blob, seen), (low + high) / 2.0, over)

    def _apart(self, blob: Blob, seen: Blob) -> float:
        both = np.concatenate([blob.outline, seen.outline])
        low = np.floor(self._view.pixels(both.min(axis=0)))
        size = np.ceil(self._view.pixels(both.max(axis=0)) - low).astype(int) + 1
        masks = []
        for each in (blob, seen):
            mask = np.zeros((int(size[1]), int(size[0])), dtype=np.uint8)
            drawn = np.round(self._view.pixels(each.outline) - low).astype(np.int32)
            masks.append(cv2.fillPoly(mask, [drawn], 1) > 0)
        return float(np.mean(masks[0] ^ masks[1]) / max(float(np.mean(masks[0] | masks[1])), 1e-9))

    def _deviation(self, blob: Blob, seen: Blob) -> float:
        sides = np.abs(np.array(blob.size_m) - np.array(seen.size_m)) - self._slack
        shares = np.maximum(sides, 0.0) / np.array(seen.size_m)
        # An outline that is half the slack too wide all round has so much more area.
        allowed = sum(seen.size_m) * self._slack
        area = max(abs(blob.area_m2 - seen.area_m2) - allowed, 0.0) / seen.area_m2
        return float(max(area, *shares))

    def _outlines(self, mesh: trimesh.Trimesh, pose: Array) -> list[Blob]:
        """What the camera would see of a part, on the plane of the tray, before and after opening.

        A side about as narrow as the opening may be seen or not.
        """
        corners = apply(pose, mesh.vertices)[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        toward = np.einsum("ij,ij->i", normals, self._view.eye - corners[:, 0]) > 0.0
        pixels = self._view.pixels(self._view.shadow(corners[toward]).reshape(-1, 2))
        low = np.floor(pixels.min(axis=0)).astype(int) - _RIM
        size = np.ceil(pixels.max(axis=0)).astype(int) - low + _RIM + 1
        mask = np.zeros((int(size[1]), int(size[0])), dtype=np.uint8)
        drawn = np.round((pixels - low) * 2**_SHIFT_BITS).astype(np.int32).reshape(-1, 3, 2)
        cv2.fillPoly(mask, list(drawn), 255, shift=_SHIFT_BITS)
        # The mask begins elsewhere than the image of the tray.
        begin = low * self._view.settings.pixel_m
        masks = (mask, opened(mask, self._open, self._view.settings.pixel_m))
        found = [blobs_of(each, self._view, 0.0) for each in masks]
        return [_moved(outlines[0], begin) for outlines in found if outlines]


def _moved(blob: Blob, way: Array) -> Blob:
    return replace(
        blob, outline=blob.outline + way, centre=blob.centre + way, corners=blob.corners + way
    )


def _long_side(flat: Array) -> float:
    """Direction of the longer side of the rectangle of least area around points [rad]."""
    _, (width, height), degrees = cv2.minAreaRect(flat.astype(np.float32))
    return float(np.deg2rad(degrees) + (0.0 if width >= height else np.pi / 2.0))
