"""Depths measured and those of a part at a pose: cost, robust step, what a motion changes."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from skinplan.mesh.model import SurfaceMesh
from skinplan.recognition.depth_rays import DepthRays, Rendered, render
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array, transform

#: A ray counts with Tukey's weight of this many standard deviations.
TUKEY = 4.685
# A ray counts no more than this many standard deviations, one that misses the part as many.
_CUT = 3.0
# Where it is checked what a motion changes, a depth counts up to so many standard deviations.
_CHECK_CUT = 15.0
_LEAST_CHI2 = 1e-3


@dataclass(frozen=True)
class ShapeSettings:
    """How a part is located by its shape.

    Attributes:
        reach_m: The part stands within this of where it is looked for [m] ...
        reach_rad: ... and is turned by no more than this.
        step_m: Starts are so far apart ...
        step_rad: ... and turned by so much.
        noise_at_1m_m: Standard deviation of a depth of 1 m; grows with its square [m].
        patch_m: Side of the patches of surface ...
        patch_error_m: ... whose mean depth is off by this standard deviation, however many images
            are taken [m].
        form_m: The mesh may be off the part by this, by its facets too [m].
        known_m: A motion that is known worse than this (sigma) is open [m].
        apart_m: Poses that differ by less ...
        apart_rad: ... and are turned by less are the same.
        chi2_apart: Another pose whose sum of normalised squares is greater by less than this is as
            good [1].
    """

    reach_m: float = 0.15
    reach_rad: float = float(np.radians(4.0))
    step_m: float = 0.025
    step_rad: float = float(np.radians(2.0))
    noise_at_1m_m: float = 0.0025
    patch_m: float = 0.04
    patch_error_m: float = 0.0005
    form_m: float = 0.0003
    known_m: float = 0.01
    apart_m: float = 0.01
    apart_rad: float = float(np.radians(1.0))
    chi2_apart: float = 50.0


class ShapeFit:
    """A part to be laid on depths; motions are turn times size and shift in its own frame [m].

    Args:
        mesh: The part.
        settings: Of the camera's errors.

    Attributes:
        pivot: What motions turn about, workpiece frame, shape (3,) [m].
        size_m: Length that turns are counted in [m].
    """

    def __init__(self, mesh: SurfaceMesh, settings: ShapeSettings) -> None:
        self._settings = settings
        self._caster, self._normals = RayCaster(mesh), mesh.face_normals
        low, high = mesh.bounds
        self.pivot = 0.5 * (low + high)
        self.size_m = 0.5 * float(np.linalg.norm(high - low))

    def render(self, rays: DepthRays, pose: Array) -> Rendered:
        """Returns what the rays see of the part at a pose ``T_camera_workpiece``."""
        return render(rays, self._caster, self._normals, pose)

    def sigma(self, rays: DepthRays, seen: Rendered) -> Array:
        """Standard deviation that each ray counts with; those of a patch share its error [m]."""
        cells = np.floor(seen.points / self._settings.patch_m).astype(np.int64)
        cells[~seen.hit] = 0
        _, patch, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        shared = count[patch.ravel()] * self._settings.patch_error_m**2
        return np.asarray(np.sqrt(rays.sigma**2 + shared))

    def step(
        self, rays: DepthRays, seen: Rendered, scale: float, allowed: Array | None = None
    ) -> tuple[Array, Array]:
        """Returns the robust step, and the information about it [1/m^2].

        Args:
            rays: The rays.
            seen: What they see now.
            scale: Rays farther off do not pull [m]; 0 = that of the noise.
            allowed: Motions as columns, shape (6, k); None = all. Those that nothing holds are left
                alone.
        """
        sigma = self.sigma(rays, seen)
        bound = np.maximum(scale, TUKEY * sigma)
        robust = (1.0 - np.minimum(np.abs(seen.residual) / bound, 1.0) ** 2) ** 2
        weight = np.where(seen.hit, robust / sigma**2, 0.0)
        rows = seen.jacobian(self.pivot, self.size_m)
        rows = rows if allowed is None else rows @ allowed
        information = rows.T @ (weight[:, None] * rows)
        values, vectors = np.linalg.eigh(information)
        held = values > self._settings.known_m**-2
        basis = vectors[:, held]
        step = basis @ ((basis.T @ (rows.T @ (weight * seen.residual))) / values[held])
        return np.asarray(step), np.asarray(information)

    def moved(self, pose: Array, motion: Array) -> Array:
        """Moves the part in its own frame: turn times size and shift, shape (6,) [m]."""
        turn = Rotation.from_rotvec(motion[:3] / self.size_m).as_matrix()
        return np.asarray(pose @ transform(self.pivot + motion[3:] - turn @ self.pivot, turn))

    def cost(self, rays: DepthRays, pose: Array, least_m: float) -> float:
        """Sum of normalised squares, each up to the cut; rays that miss the part count fully."""
        seen = self.render(rays, pose)
        sigma = np.maximum(self.sigma(rays, seen), least_m)
        squares = np.minimum((seen.residual / sigma) ** 2, _CUT**2)
        return float(np.where(seen.hit, squares, _CUT**2).sum())

    def checked(self, rays: DepthRays, pose: Array, seen: Rendered, direction: Array) -> float:
        """Returns the standard deviation of a motion by what a real one of `known_m` changes [m].

        Changes of the depth below `form_m` do not count: the facets of a cylinder would seem to
        hold its turn. Only rays that meet the part before and after count, so the outline holds
        nothing.
        """
        far, sigma = self._settings.known_m, self.sigma(rays, seen)
        found = []
        for way in (-far, far):
            then = self.render(rays, self.moved(pose, way * direction))
            both = seen.hit & then.hit
            change = np.abs(then.residual - seen.residual)[both] - self._settings.form_m
            squares = (np.maximum(change, 0.0) / sigma[both]) ** 2
            found.append(float(np.minimum(squares, _CHECK_CUT**2).sum()))
        return far / float(np.sqrt(max(min(found), _LEAST_CHI2)))

    def covariance(self, pose: Array, motion: Array) -> Array:
        """Takes the covariance of a motion about the pivot, (6, 6) [m^2], to the optical frame."""
        x, y, z = -self.pivot
        lever = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        turned = pose[:3, :3]
        carried = np.zeros((6, 6))
        carried[:3, :3] = turned @ lever / self.size_m
        carried[:3, 3:] = turned
        carried[3:, :3] = turned / self.size_m
        return np.asarray(carried @ motion @ carried.T)
