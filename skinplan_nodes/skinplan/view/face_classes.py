"""Which colour each face gets, and what the colours mean."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import InputError
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.mesh.topology import components
from skinplan.scanner.facet_states import facet_states
from skinplan.scanner.model import Coverage
from skinplan.scanner.sight import Sight
from skinplan.transforms import Array
from skinplan.view import palette
from skinplan.view.display_mesh import DisplayMesh

# Unseen samples nearer to each other than this many sample spacings are one hole.
_ONE_HOLE = 3.0


@dataclass(frozen=True, eq=False)
class FaceClasses:
    """A class for each face, with name and colour.

    Attributes:
        codes: Number of the class of each face, shape (f,).
        names: Names of the classes, for the legend.
        colours: Red, green, blue in [0, 1], shape (len(names), 3).
    """

    codes: NDArray[np.int64]
    names: tuple[str, ...]
    colours: Array

    def __post_init__(self) -> None:
        if self.colours.shape != (len(self.names), 3):
            raise InputError(
                f"one colour for each of the {len(self.names)} classes is accepted, found colours "
                f"of shape {self.colours.shape}"
            )
        if len(self.codes) and not 0 <= self.codes.min() <= self.codes.max() < len(self.names):
            raise InputError(
                f"codes from 0 to {len(self.names) - 1} are accepted, found {self.codes.min()} to "
                f"{self.codes.max()}"
            )

    @property
    def present(self) -> tuple[int, ...]:
        """Numbers of the classes that any face has, rising."""
        return tuple(int(number) for number in np.unique(self.codes))

    @property
    def face_colours(self) -> Array:
        """Colour of each face, shape (f, 3)."""
        return self.colours[self.codes]

    def of(self, display: DisplayMesh) -> "FaceClasses":
        """Returns the classes of a display mesh made of this mesh."""
        return FaceClasses(self.codes[display.parents], self.names, self.colours)


@dataclass(frozen=True, eq=False)
class Hole:
    """A connected piece of surface that no view sees.

    Attributes:
        points: Its samples, shape (k, 3) [m].
        area_m2: Its area [m^2].
    """

    points: Array
    area_m2: float


def region_classes(mesh: SurfaceMesh, segmentation: Segmentation) -> FaceClasses:
    """Makes one class of the flat surface and one of each complex region, with their areas."""
    count = segmentation.regions
    areas = np.bincount(segmentation.face_region, weights=mesh.face_areas, minlength=count + 1)
    names = [f"flat surface, {areas[0]:.3f} m²"]
    names += [f"region {number}, {areas[number]:.3f} m²" for number in range(1, count + 1)]
    return FaceClasses(segmentation.face_region, tuple(names), palette.region_colours(count))


def coverage_classes(coverage: Coverage, display: DisplayMesh) -> FaceClasses:
    """Makes the classes of a coverage certificate: seen often, seen, and the reasons why not.

    Args:
        coverage: The certificate.
        display: A mesh for the eye, made of the mesh that was judged.

    Returns:
        The classes. Faces that were cut for the eye get the class of the sample nearest to their
        middle: a large face may be seen in part.

    Raises:
        InputError: The certificate has no samples, or is one of another mesh.
    """
    if not len(coverage.views) or display.parents.max(initial=-1) >= len(coverage.mesh.faces):
        raise InputError(
            f"a certificate of this mesh is accepted, found one with {len(coverage.views)} samples "
            f"of a mesh of {len(coverage.mesh.faces)} faces"
        )
    states = facet_states(coverage)
    if len(display.parents) > len(coverage.mesh.faces):
        _, nearest = cKDTree(coverage.samples.points).query(display.mesh.centroids)
        codes = coverage.sights[nearest].astype(np.int64)
    else:
        codes = states.codes[display.parents].astype(np.int64)
    names = tuple(
        name if code <= Sight.SEEN else f"hole: {name}" for code, name in enumerate(states.names)
    )
    return FaceClasses(codes, names, states.colours / 255.0)


def holes(coverage: Coverage) -> tuple[Hole, ...]:
    """Finds the connected pieces that no view sees, the largest first."""
    unseen = np.flatnonzero(coverage.views == 0)
    if not len(unseen):
        return ()
    points, weights = coverage.samples.points[unseen], coverage.samples.weights[unseen]
    reach = _ONE_HOLE * float(np.sqrt(coverage.samples.weights.max()))
    pairs = cKDTree(points).query_pairs(reach, output_type="ndarray")
    found, labels = components(len(points), pairs)
    areas = np.bincount(labels, weights=weights, minlength=found)
    members = np.split(
        points[np.argsort(labels, kind="stable")],
        np.cumsum(np.bincount(labels, minlength=found))[:-1],
    )
    order = np.lexsort((np.arange(found), -np.round(areas, 12)))
    return tuple(Hole(members[i], float(areas[i])) for i in order)
