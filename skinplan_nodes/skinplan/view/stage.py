"""The views of a part that several pictures share, made once."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array
from skinplan.view.camera import ParallelView, front_view, is_upside_down, raised_view
from skinplan.view.display_mesh import DisplayMesh, refined
from skinplan.view.raster import Light, Raster, coloured, rasterise, smaller
from skinplan.view.subject import Subject

IMAGE_PX = 1480
_OVERSAMPLE = 2
_MOST_PIXELS = 800_000
_RELIEF = 0.42


@dataclass(frozen=True, eq=False)
class Stage:
    """A subject, its mesh for the eye, and its views.

    Attributes:
        subject: What is shown.
    """

    subject: Subject

    @cached_property
    def display(self) -> DisplayMesh:
        """The mesh whose faces are coloured."""
        return refined(self.subject.mesh)

    @cached_property
    def front(self) -> Raster:
        """From the front, as it stands in the shop; several pixels for one of the picture."""
        return self._raster(lambda width: front_view(self.subject.mesh, width, self._turned))

    @cached_property
    def raised(self) -> Raster:
        """From above the front."""
        return self._raster(
            lambda width: raised_view(self.subject.mesh, width, turned=self._turned)
        )

    def image(
        self, raster: Raster, face_colours: Array, relief: float = _RELIEF
    ) -> NDArray[np.uint8]:
        """Returns the picture of the display mesh, shape (rows, columns, 4).

        Args:
            raster: `front` or `raised`.
            face_colours: Red, green, blue of the faces of `display`, shape (f, 3).
            relief: Strength of the shading [1]; the less, the truer the colours.
        """
        light = Light.of(self.front.view.right, self.front.view.toward, relief)
        return smaller(coloured(raster, self.display.mesh, face_colours, light), _OVERSAMPLE)

    def plain(self, raster: Raster, colour: tuple[float, float, float]) -> NDArray[np.uint8]:
        """Returns the picture of the display mesh in one colour, shape (rows, columns, 4)."""
        return self.image(raster, np.tile(colour, (len(self.display.mesh.faces), 1)))

    def extent_with(
        self, raster: Raster, points: Array, spare_m: float
    ) -> tuple[float, float, float, float]:
        """Returns left, right, bottom, top of a window that also shows points, shape (n, 3) [m].

        Args:
            raster: `front` or `raised`.
            points: What else to show.
            spare_m: Room around the points [m].
        """
        left, right, bottom, top = raster.view.extent
        if not len(points):
            return left, right, bottom, top
        flat = raster.view.plane(points)
        low, high = flat.min(axis=0) - spare_m, flat.max(axis=0) + spare_m
        return (
            float(min(left, low[0])),
            float(max(right, high[0])),
            float(min(bottom, low[1])),
            float(max(top, high[1])),
        )

    @cached_property
    def _turned(self) -> bool:
        return is_upside_down(self.subject.mesh, self.subject.T_map_workpiece)

    @cached_property
    def _caster(self) -> RayCaster:
        return RayCaster(self.display.mesh)

    def _raster(self, viewed: Callable[[int], ParallelView]) -> Raster:
        view = viewed(IMAGE_PX)
        if view.rows * view.columns > _MOST_PIXELS:
            view = viewed(int(IMAGE_PX * np.sqrt(_MOST_PIXELS / (view.rows * view.columns))))
        return rasterise(self.display.mesh, view.finer(_OVERSAMPLE), self._caster)
