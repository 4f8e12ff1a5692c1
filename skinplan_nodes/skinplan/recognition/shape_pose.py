"""Where a part stands, by depth images and its shape alone: the answer to a missing marker.

The part is rendered from where the camera stands, and the pose is sought at which the depths are
those that were measured. It starts from a grid of places about the nominal one, in the plane that
the part shows to the camera, and says what the images leave open: a plate slides along itself, a
body of revolution turns. The outline of the part does not hold the pose: the edges are what a depth
camera sees worst.
"""

from dataclasses import dataclass

import numpy as np

from skinplan.errors import AlignmentError
from skinplan.inspection.determined import motions
from skinplan.inspection.model import Motion
from skinplan.mesh.model import SurfaceMesh
from skinplan.recognition.depth_rays import DepthRays, Rendered
from skinplan.recognition.shape_fit import TUKEY, ShapeFit, ShapeSettings
from skinplan.transforms import Array, apply, difference, inverse, require_transform

_FEWEST = 200
# Less of the depths measured before it on it is another part, or another place.
_LIES_ON_IT = 0.5
# Rays that the places of the grid are compared by, and that the best of them are settled with.
_FEW, _MORE = 300, 1500
_SETTLED = 8
# Scales of the steps [m]: beyond, a ray pulls no longer. The last one is that of the noise.
_FIRST, _NEXT, _LAST = (0.2, 0.1, 0.05), (0.03, 0.03, 0.015, 0.015), 12
# Places of the grid are compared as if a depth were off by this at least [m].
_COARSE_M = 0.005
_CONVERGED_M = 2e-5
# Standard deviation of a motion that nothing holds at all [m].
_OPEN_M = 1.0


@dataclass(frozen=True, eq=False)
class ShapePose:
    """A pose by the shape.

    Attributes:
        T_camera_workpiece: Optical frame, shape (4, 4) [m].
        covariance: Of the pose: x y z [m] rx ry rz [rad] in the optical frame, turns about the
            workpiece's origin, shape (6, 6). Open motions have a standard deviation between
            `ShapeSettings.known_m` and 1 m.
        residual_m: Root mean square of the depths' deviation [m].
        undetermined: Motions that the images leave open.
        chi2_behind: By how much the sum of normalised squares of the best other pose is greater;
            infinite = there is none [1].
        doubt: Why it can't be told where the part is; empty = it can.
    """

    T_camera_workpiece: Array
    covariance: Array
    residual_m: float
    undetermined: tuple[Motion, ...]
    chi2_behind: float
    doubt: str


def locate_shape(
    points: Array,
    mesh: SurfaceMesh,
    T_camera_workpiece: Array,
    settings: ShapeSettings | None = None,
) -> ShapePose:
    """Finds where a part stands.

    Args:
        points: Of depth images from one stand, optical frame, shape (n, 3) [m].
        mesh: The part.
        T_camera_workpiece: Where it is looked for, shape (4, 4) [m].
        settings: How.

    Returns:
        The pose, what it is worth, and what is open.

    Raises:
        NoCloudError: Hardly a point lies where the part may be.
        AlignmentError: It is not within the bounds.
        InputError: A pose that is none.
    """
    start = require_transform(T_camera_workpiece, "T_camera_workpiece")
    return _Search(points, mesh, start, settings or ShapeSettings()).run()


class _Search:
    """One part before one camera."""

    def __init__(
        self, points: Array, mesh: SurfaceMesh, start: Array, settings: ShapeSettings
    ) -> None:
        self._start, self._settings = start, settings
        self._fit = ShapeFit(mesh, settings)
        low, high = mesh.bounds
        margin = settings.reach_m + settings.reach_rad * self._fit.size_m
        local = apply(inverse(start), points)
        near = np.all((local >= low - margin) & (local <= high + margin), axis=1)
        self._rays = DepthRays.of(points[near], settings.noise_at_1m_m, _FEWEST)
        self._few, self._more = self._rays.thinned(_FEW), self._rays.thinned(_MORE)

    def run(self) -> ShapePose:
        """Returns the best pose."""
        faced = self._faced()
        poses = [self._settled(self._more, pose, _NEXT) for pose in self._starts(faced)]
        poses = [self._refined(pose) for pose in poses]
        costs = [self._fit.cost(self._rays, pose, 0.0) for pose in poses]
        best = int(np.argmin(costs))
        pose = poses[best]
        others = [
            cost - costs[best]
            for cost, other in zip(costs, poses, strict=True)
            if self._differ(pose, other)
        ]
        found = self._judged(pose, min(others, default=float("inf")))
        # What is open may have run away along it: that is no other place.
        if not found.undetermined:
            self._require_near(pose)
        return found

    def _faced(self) -> Array:
        """Returns the start, moved to the measured depth and slant: no motion along the surface."""
        pose = self._start
        for scale in _FIRST:
            for _ in range(3):
                seen = self._fit.render(self._more, pose)
                if not seen.hit.any():
                    break
                axes = self._axes(seen)
                tilts = np.zeros((6, 3))
                tilts[3:, 0] = axes[:, 2]
                tilts[:3, 1:] = axes[:, :2]
                step = tilts @ self._fit.step(self._more, seen, scale, tilts)[0]
                pose = self._fit.moved(pose, step)
        return pose

    def _axes(self, seen: Rendered) -> Array:
        """Two directions along the surface that is seen and its normal, as columns (3, 3)."""
        toward = -seen.slopes[seen.hit].mean(axis=0)
        z = toward / np.linalg.norm(toward)
        x = np.eye(3)[int(np.argmin(np.abs(z)))]
        x = x - (x @ z) * z
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(z, x), z], axis=1)

    def _starts(self, faced: Array) -> list[Array]:
        """Returns the best different places of a grid along the surface."""
        settings = self._settings
        seen = self._fit.render(self._few, faced)
        if not seen.hit.any():
            raise AlignmentError(
                "the part was looked for, but nothing is measured where it is expected; a part "
                "within the bounds is accepted"
            )
        axes = self._axes(seen)
        shifts = _ladder(settings.reach_m, settings.step_m)
        turns = _ladder(settings.reach_rad, settings.step_rad)
        tried = [
            self._fit.moved(
                faced, np.concatenate([turn * self._fit.size_m * axes[:, 2], axes[:, :2] @ [x, y]])
            )
            for x in shifts
            for y in shifts
            if np.hypot(x, y) <= settings.reach_m + 1e-9
            for turn in turns
        ]
        costs = [self._fit.cost(self._few, pose, _COARSE_M) for pose in tried]
        kept: list[Array] = []
        for number in np.argsort(costs, kind="stable"):
            if all(self._differ(tried[number], other) for other in kept):
                kept.append(tried[number])
            if len(kept) == _SETTLED:
                break
        return kept

    def _differ(self, one: Array, other: Array) -> bool:
        middle = self._fit.pivot[None]
        apart = float(np.linalg.norm(apply(one, middle) - apply(other, middle)))
        turned = difference(one, other)[1]
        return apart > self._settings.apart_m or turned > self._settings.apart_rad

    def _settled(self, rays: DepthRays, pose: Array, scales: tuple[float, ...]) -> Array:
        for scale in scales:
            seen = self._fit.render(rays, pose)
            pose = self._fit.moved(pose, self._fit.step(rays, seen, scale)[0])
        return pose

    def _refined(self, pose: Array) -> Array:
        for _ in range(_LAST):
            seen = self._fit.render(self._rays, pose)
            step, _ = self._fit.step(self._rays, seen, 0.0)
            pose = self._fit.moved(pose, step)
            if float(np.linalg.norm(step)) < _CONVERGED_M:
                break
        return pose

    def _require_near(self, pose: Array) -> None:
        settings = self._settings
        middle = self._fit.pivot[None]
        away = float(np.linalg.norm(apply(pose, middle) - apply(self._start, middle)))
        turned = difference(pose, self._start)[1]
        if away > settings.reach_m or turned > settings.reach_rad:
            raise AlignmentError(
                f"the part fits best {away * 1e3:.0f} mm and {np.degrees(turned):.1f} deg from "
                f"where it was looked for; up to {settings.reach_m * 1e3:.0f} mm and "
                f"{np.degrees(settings.reach_rad):.1f} deg are accepted"
            )

    def _judged(self, pose: Array, chi2_behind: float) -> ShapePose:
        seen = self._fit.render(self._rays, pose)
        sigma = self._fit.sigma(self._rays, seen)
        on_it = seen.hit & (np.abs(seen.residual) < TUKEY * sigma)
        if np.count_nonzero(on_it) < _FEWEST:
            raise AlignmentError(
                f"the part was looked for, but {np.count_nonzero(on_it)} pixels lie on it where "
                f"it fits best; at least {_FEWEST} are accepted"
            )
        if np.count_nonzero(on_it) < _LIES_ON_IT * np.count_nonzero(seen.hit):
            raise AlignmentError(
                "the part was looked for, but of the depths measured before it where it fits best "
                f"{100 * np.count_nonzero(on_it) / np.count_nonzero(seen.hit):.0f} % lie on it; at "
                f"least {100 * _LIES_ON_IT:.0f} % are accepted"
            )
        _, information = self._fit.step(self._rays, seen, 0.0)
        # Where the depths scatter more than was assumed, that counts.
        scatter = max(1.0, float(np.mean((seen.residual[on_it] / sigma[on_it]) ** 2)))
        values, vectors = np.linalg.eigh(information)
        checked = [self._fit.checked(self._rays, pose, seen, each) for each in vectors.T]
        sigmas = np.sqrt(scatter) * np.maximum(1.0 / np.sqrt(np.maximum(values, 1e-6)), checked)
        sigmas = np.minimum(sigmas, _OPEN_M)
        lost = sigmas > self._settings.known_m
        undetermined = motions(vectors[:, lost], self._fit.size_m)
        return ShapePose(
            pose,
            self._fit.covariance(pose, (vectors * sigmas**2) @ vectors.T),
            float(np.sqrt(np.mean(seen.residual[on_it] ** 2))),
            undetermined,
            chi2_behind,
            self._doubt(undetermined, chi2_behind),
        )

    def _doubt(self, undetermined: tuple[Motion, ...], chi2_behind: float) -> str:
        if undetermined:
            return f"the images leave open: {', '.join(motion.text for motion in undetermined)}"
        if chi2_behind < self._settings.chi2_apart:
            return (
                f"another pose fits about as well: its sum of normalised squares is greater by "
                f"{chi2_behind:.0f}, at least {self._settings.chi2_apart:.0f} is accepted"
            )
        return ""


def _ladder(reach: float, step: float) -> Array:
    count = int(np.floor(reach / step + 1e-9))
    return np.asarray(step * np.arange(-count, count + 1), dtype=float)
