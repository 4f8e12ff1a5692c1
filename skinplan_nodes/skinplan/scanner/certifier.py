"""Certifies several sets of views on one part: what they share is made once."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.scan_path.model import ScanPath
from skinplan.scanner.figures import seen_ratio
from skinplan.scanner.model import Coverage, ScannerModel
from skinplan.scanner.motion import STEP_M, STEP_RAD, row_sequences, views_between
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.scanner.seeable import seeable
from skinplan.scanner.tally import Tally
from skinplan.scanner.views import checked_views
from skinplan.transforms import Array


class Certifier:
    """A part, its surroundings and a scanner, ready to say what views see.

    Args:
        mesh: The part.
        segmentation: Its complex regions.
        scanner: Field of view, range and incidence limit.
        spacing_m: Distance between the surface samples [m].
        caster: Rays against the mesh and what stands about it, when they are at hand.
        occluders: What else may hide the part, in its frame: the fixture.
        least_views: Number n of views that is asked for, at least 1.
        clearance_m: Least distance of the scanner's origin from the part [m]: also says what can be
            seen at all. None = that is not asked.

    Raises:
        InputError: A segmentation of another mesh, fewer than 1 view, or rays and occluders both.
    """

    def __init__(
        self,
        mesh: SurfaceMesh,
        segmentation: Segmentation,
        scanner: ScannerModel,
        spacing_m: float = 0.005,
        caster: RayCaster | None = None,
        occluders: Sequence[SurfaceMesh] = (),
        least_views: int = 3,
        clearance_m: float | None = None,
    ) -> None:
        if segmentation.face_region.shape != (len(mesh.faces),):
            raise InputError(
                f"a segmentation of the mesh's {len(mesh.faces)} faces is accepted, "
                f"found one of {len(segmentation.face_region)} faces"
            )
        if not least_views >= 1:
            raise InputError(f"at least 1 view can be asked for, found {least_views}")
        if caster is not None and len(occluders):
            raise InputError(
                "rays at hand or occluders are accepted, found both: the rays have to be made "
                "with the occluders"
            )
        self.mesh, self.scanner = mesh, scanner
        self.samples = sample_surface(mesh, spacing_m)
        self.caster = caster or RayCaster(mesh, occluders)
        self._regions = segmentation.face_region[self.samples.faces]
        self._least = int(least_views)
        self._clearance_m = clearance_m

    @cached_property
    def can_be_seen(self) -> NDArray[np.bool_] | None:
        """Whether an admissible pose sees each sample, shape (s,); None = not asked."""
        if self._clearance_m is None:
            return None
        return seeable(self.mesh, self.samples, self.scanner, self._clearance_m, self.caster)

    def points(self, path: ScanPath) -> Coverage:
        """Says what the points of a scan path see.

        Args:
            path: The scan path, in the frame of the mesh.

        Returns:
            The coverage; all counts are exact.

        Raises:
            ScanPathInvalidError: The path is not finite, or a direction is no unit vector.
        """
        tally = Tally(self.samples, self.caster, self.scanner)
        tally.add(*checked_views(path.positions, path.directions))
        return self._coverage(tally)

    def motion(
        self,
        path: ScanPath,
        sequences: Sequence[NDArray[np.int64]] | None = None,
        step_m: float = STEP_M,
        step_rad: float = STEP_RAD,
    ) -> Coverage:
        """Says what the points of a scan path and the motion between them see.

        Samples that the points see as often as asked for are not tested along the motion. So
        whether a sample is seen, seen often enough, or why not, is exact for the interpolated
        views; counts are exact below n, and the incidence angles are those of the views tested.

        Args:
            path: The scan path, in the frame of the mesh.
            sequences: Point numbers in the order of motion, one array for each motion that scans;
                None = the rows, each for itself.
            step_m: Largest distance between the views [m].
            step_rad: Largest angle between the views [rad].

        Returns:
            The coverage.

        Raises:
            ScanPathInvalidError: A path or sequence that can't be used.
            InputError: A step that is not positive, or too small.
        """
        tally = Tally(self.samples, self.caster, self.scanner)
        chosen = row_sequences(path) if sequences is None else sequences
        between = views_between(path.positions, path.directions, chosen, step_m, step_rad)
        tally.add(*checked_views(path.positions, path.directions))
        tally.add_until(*between, self._least)
        return self._coverage(tally)

    def track(self, positions: Array, directions: Array) -> Coverage:
        """Says what the real track of a trajectory sees: all its poses are views.

        What is exact is as in `motion`.

        Args:
            positions: Scanner origins in the frame of the mesh, shape (n, 3) [m].
            directions: Unit view directions, shape (n, 3).

        Returns:
            The coverage.

        Raises:
            ScanPathInvalidError: The track is not finite, or a direction is no unit vector.
        """
        tally = Tally(self.samples, self.caster, self.scanner)
        tally.add_until(*checked_views(positions, directions), self._least)
        return self._coverage(tally)

    def _coverage(self, tally: Tally) -> Coverage:
        samples, views = self.samples, tally.views
        feature = self._regions > 0
        everywhere = np.ones(len(feature), dtype=bool)
        able = self.can_be_seen
        # What a view of this path sees can be seen, whatever the search for poses has missed.
        able = None if able is None else able | (views > 0)
        inside = np.zeros_like(everywhere) if able is None else able
        return Coverage(
            samples=samples,
            views=views,
            area_ratio=seen_ratio(samples, views, everywhere),
            feature_area_ratio=seen_ratio(samples, views, feature),
            mesh=self.mesh,
            regions=self._regions,
            scanner=self.scanner,
            least_views=self._least,
            axis_rad=tally.axis_rad,
            ray_rad=tally.ray_rad,
            reasons=tally.reasons(),
            can_be_seen=able,
            seeable_area_ratio=(
                float("nan") if able is None else seen_ratio(samples, able * 1, everywhere)
            ),
            area_ratio_of_seeable=seen_ratio(samples, views, inside),
            feature_area_ratio_of_seeable=seen_ratio(samples, views, inside & feature),
        )
