"""The image of a mesh by rays: which face each pixel shows, its colour and shading."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array
from skinplan.view.camera import ParallelView

# A surface that looks at the front is so bright; what is turned away from the light is darker.
_STRAIGHT = 0.93
_DARKEST = 0.38
_BACK_SIDE = 0.30
_CLEAR_M = 0.05


@dataclass(frozen=True, eq=False)
class Raster:
    """What each pixel of a view shows.

    Attributes:
        view: The view.
        faces: Face numbers, shape (rows, columns), -1 where there is nothing.
        depth: Depth of the surface, shape (rows, columns) [m]; -inf where there is nothing.
    """

    view: ParallelView
    faces: NDArray[np.int64]
    depth: Array

    def visible(self, points: Array, tolerance_m: float) -> NDArray[np.bool_]:
        """Says which points nothing hides.

        Args:
            points: shape (n, 3) [m], in the frame of the mesh.
            tolerance_m: Points so far behind the surface still count as visible [m].

        Returns:
            shape (n,); points outside the window are not visible.
        """
        cells = self.view.pixels(points)
        inside: NDArray[np.bool_] = np.all((cells >= 0) & (cells < self.depth.shape), axis=1)
        row, column = np.where(inside[:, None], cells, 0).T
        hidden: NDArray[np.bool_] = self.view.depth(points) < self.depth[row, column] - tolerance_m
        return inside & ~hidden


def rasterise(mesh: SurfaceMesh, view: ParallelView, caster: RayCaster | None = None) -> Raster:
    """Finds what each pixel shows.

    Args:
        mesh: The part, at least one face.
        view: The view.
        caster: Rays against the mesh, when they are at hand.

    Returns:
        The raster.

    Raises:
        InputError: No faces.
    """
    rays = caster or RayCaster(mesh)
    far = float(view.depth(mesh.vertices).max()) + _CLEAR_M
    starts = view.pixel_centres().reshape(-1, 3) + far * view.toward
    distance, faces = rays.hits(starts, np.broadcast_to(-view.toward, starts.shape))
    shape = (view.rows, view.columns)
    return Raster(view, faces.reshape(shape), (far - distance).reshape(shape))


@dataclass(frozen=True, eq=False)
class Light:
    """Where the light comes from.

    Attributes:
        front: Unit normal of the surfaces that look straight at the front, shape (3,).
        toward: Unit vector to the light, shape (3,).
        strength: How much brighter or darker tilted surfaces are [1]; 0 = all alike.
    """

    front: Array
    toward: Array
    strength: float = 0.42

    @classmethod
    def of(cls, right: Array, front: Array, strength: float = 0.42) -> "Light":
        """Makes light from the upper left before the front; right and front are unit vectors."""
        toward = -0.45 * right + 0.55 * np.cross(front, right) + 0.70 * front
        return cls(front, toward / np.linalg.norm(toward), strength)

    def brightness(self, normals: Array) -> Array:
        """Returns how bright surfaces with unit normals, shape (f, 3), are, in [0.38, 1]."""
        turned = normals @ self.toward - float(self.front @ self.toward)
        return np.clip(_STRAIGHT + self.strength * turned, _DARKEST, 1.0)


def coloured(
    raster: Raster, mesh: SurfaceMesh, face_colours: Array, light: Light
) -> NDArray[np.uint8]:
    """Colours the faces that each pixel shows, shaded.

    Args:
        raster: What the pixels show.
        mesh: The mesh that it was made of.
        face_colours: Red, green, blue in [0, 1], shape (f, 3).
        light: The light.

    Returns:
        Red, green, blue, opacity, shape (rows, columns, 4); transparent where there is nothing.

    Raises:
        InputError: Not one colour per face.
    """
    colours = np.asarray(face_colours, dtype=float)
    if colours.shape != (len(mesh.faces), 3):
        raise InputError(
            f"colours of shape ({len(mesh.faces)}, 3), one per face, are accepted, "
            f"found {colours.shape}"
        )
    # The last row is what index -1 finds: nothing.
    table = np.zeros((len(colours) + 1, 4), dtype=np.uint8)
    bright = _brightness(mesh.face_normals, light, raster.view)
    table[:-1, :3] = np.rint(255.0 * np.clip(colours * bright[:, None], 0.0, 1.0))
    table[:-1, 3] = 255
    return table[raster.faces]


def smaller(image: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """Returns the image at a whole fraction of its size: edges become smooth.

    Args:
        image: Red, green, blue, opacity, shape (rows, columns, 4), multiples of the factor.
        factor: How many pixels become one, each way.
    """
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    total = np.zeros((rows, columns, 4), dtype=np.float32)
    for row in range(factor):
        for column in range(factor):
            pixel = image[row::factor, column::factor].astype(np.float32)
            total[..., :3] += pixel[..., :3] * pixel[..., 3:]
            total[..., 3] += pixel[..., 3]
    total[..., :3] /= np.maximum(total[..., 3:], 1e-6)
    total[..., 3] /= factor**2
    return np.rint(total).astype(np.uint8)


def _brightness(normals: Array, light: Light, view: ParallelView) -> Array:
    """Returns how bright faces are, shape (f,); a back side is darker than its front ever is."""
    facing = normals @ view.toward
    return np.where(facing >= -1e-9, light.brightness(normals), _BACK_SIDE)
