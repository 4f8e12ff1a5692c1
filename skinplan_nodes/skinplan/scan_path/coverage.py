"""Strategy ``coverage``: the fewest passes and viewpoints that see all of the part often enough.

Candidates are poses on wide passes that follow the averaged surface, views tilted to all sides
into the complex regions, and views of whatever those leave short. The fewest are chosen by a cover
with demands and a proven bound: each sample of the surface is to be seen by `least_views` poses,
with a margin to the limits of the scanner. What was chosen is judged with samples 5 mm apart; where
they are seen too seldom they join the samples and the choice is made again.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from skinplan.errors import MeshRefusedError
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.scan_path.averages import AveragedSurface
from skinplan.scan_path.clearance import Clearance
from skinplan.scan_path.frame import (
    RowFrame,
    base_normal,
    candidate_frames,
    given_frame,
    vertex_areas,
)
from skinplan.scan_path.model import FEATURE, ROW, ScanPath
from skinplan.scan_path.passes import PassCutter
from skinplan.scan_path.poses import SINGLE, Poses
from skinplan.scan_path.view_choice import (
    Choice,
    ViewChooser,
    below,
    beside,
    enough,
    planning_samples,
    some_of,
)
from skinplan.scan_path.viewpoints import shifted, thinned, viewpoints, views_about
from skinplan.scanner.coverage import visible
from skinplan.scanner.model import ScannerModel, SurfaceSamples
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array

# Views of features: places this share of r_f apart, tilted so far and to so many sides.
_FEATURE_GRID_RATIO = 0.5
_FEATURE_TILTS_RAD = tuple(np.deg2rad([10.0, 25.0]))
_FEATURE_SIDES = 8
# Views of what those leave short.
_SHORT_GRID_RATIO = 0.25
_SHORT_TILTS_RAD = tuple(np.deg2rad([10.0, 25.0, 40.0, 55.0]))
_SHORT_SIDES = 12
_RIM_SHARES = (0.5, 0.9)
_SHORT_ROUNDS = 3
_SHIFT_RATIO = 0.15
# Each place left short gets so many views to choose from, per view wanted.
_CHOICES = 2
# So many numbers of passes are compared, from the fewest that leave no strip between them.
_PASS_COUNTS = 3
# A further pass costs a turn; about so many points take as long.
_PASS_COST = 2.0
_TURN_M = 0.5
_CHECK_SPACING_M = 0.005
_CHECK_ROUNDS = 3
_MOST_ADDED = 600
# Choosing again pays while more than this share of the area is seen too seldom.
_SHORT_AREA_RATIO = 4e-4


@dataclass(frozen=True, eq=False)
class _Candidates:
    poses: Poses
    matrix: csr_matrix


def coverage_path(
    mesh: SurfaceMesh, segmentation: Segmentation, settings: ScanSettings
) -> ScanPath:
    """Plans the path with the fewest points that sees all that can be seen, often enough.

    Args:
        mesh: A checked mesh.
        segmentation: Its complex regions.
        settings: Checked settings; ``least_views`` and the margins say how well.

    Returns:
        The path: points on passes, then single viewpoints.

    Raises:
        MeshRefusedError: No face looks to the scanner's side, or no pose sees anything.
        PartInvalidError: The row direction is perpendicular to the part.
    """
    planner = CoveragePlanner(mesh, segmentation, settings)
    samples = planning_samples(mesh, segmentation, settings.field_radius_m)
    return planner.path(samples, sample_surface(mesh, _CHECK_SPACING_M))


class CoveragePlanner:
    """Plans views of (some of) the surface of a part."""

    def __init__(
        self, mesh: SurfaceMesh, segmentation: Segmentation, settings: ScanSettings
    ) -> None:
        """Prepares a part.

        Args:
            mesh: A checked mesh.
            segmentation: Its complex regions.
            settings: Checked settings.

        Raises:
            MeshRefusedError: No face looks to the scanner's side.
            PartInvalidError: The row direction is perpendicular to the part.
        """
        self._mesh, self._regions, self._settings = mesh, segmentation.face_region, settings
        base = base_normal(mesh)
        self._surface = AveragedSurface(mesh, base, settings.field_radius_m)
        self._caster = RayCaster(mesh)
        self._clearance = Clearance(mesh, self._caster)
        self._scanner = ScannerModel.from_settings(settings)
        frames = (
            candidate_frames(mesh.vertices, base, vertex_areas(mesh))
            if settings.row_direction is None
            else (given_frame(base, settings.row_direction),)
        )
        self._cutter, self._frame = self._least_passes(frames)

    def path(self, samples: SurfaceSamples, checked: SurfaceSamples) -> ScanPath:
        """Plans views of samples.

        Args:
            samples: What is to be seen.
            checked: The same surface more finely: what was chosen is judged with these.

        Raises:
            MeshRefusedError: No pose sees anything.
        """
        chooser = ViewChooser(
            samples, self._caster, self._with_margins(), self._settings.least_views
        )
        candidates = self._candidates(chooser)
        choice = chooser.choose(candidates.poses, candidates.matrix)
        for _ in range(_CHECK_ROUNDS):
            more = self._short_samples(chooser, candidates, choice, checked)
            if more is None:
                break
            chooser, candidates = more
            choice = chooser.choose(candidates.poses, candidates.matrix)
        if not len(choice.poses):
            raise MeshRefusedError(
                f"none of {len(candidates.poses)} scan poses sees anything of the part within the "
                "scanner's range and incidence; a surface that can be seen from outside at the "
                "stand-off is accepted"
            )
        return self._as_path(choice)

    def _with_margins(self) -> ScannerModel:
        """The scanner as planned with: what it just sees is not counted on."""
        settings = self._settings
        return self._scanner.narrowed(settings.field_margin_m, settings.incidence_margin_rad)

    def _least_passes(self, frames: tuple[RowFrame, ...]) -> tuple[PassCutter, RowFrame]:
        """Returns the direction in which the passes and their turns are shortest."""
        radius, standoff = self._settings.field_radius_m, self._settings.standoff_m
        cutters = [PassCutter(self._mesh, self._surface, f, radius, standoff) for f in frames]
        lengths = [cutter.length_m + _TURN_M * cutter.fewest for cutter in cutters]
        best = int(np.argmin(np.round(lengths, 3)))
        return cutters[best], frames[best]

    def _candidates(self, chooser: ViewChooser) -> _Candidates:
        """Makes the candidates: passes in the number that needs least, and viewpoints."""
        options = []
        for count in range(self._cutter.fewest, self._cutter.fewest + _PASS_COUNTS):
            poses = self._kept(self._cutter.cut(count))
            matrix = chooser.matrix(poses)
            # What passes leave short single views have to see.
            single = self._settings.least_views * chooser.short_area(matrix) / self._field_m2
            cost = chooser.fewest(matrix) + single + _PASS_COST * count
            options.append((round(cost, 6), count, _Candidates(poses, matrix)))
        passes = min(options, key=lambda entry: entry[:2])[2]
        found = self._extended(chooser, passes, self._feature_views(chooser))
        return self._with_short_views(chooser, found)

    @property
    def _field_m2(self) -> float:
        return float(np.pi * self._settings.field_radius_m**2)

    def _extended(self, chooser: ViewChooser, found: _Candidates, more: Poses) -> _Candidates:
        return _Candidates(
            Poses.joined([found.poses, more]), beside(found.matrix, chooser.matrix(more))
        )

    def _feature_views(self, chooser: ViewChooser) -> Poses:
        """Views of the complex regions, straight and tilted."""
        places = chooser.samples.points[self._regions[chooser.samples.faces] > 0]
        grid = _FEATURE_GRID_RATIO * self._settings.field_radius_m
        places = places[thinned(places, self._frame, grid)]
        return self._views(places, _FEATURE_TILTS_RAD, _FEATURE_SIDES)

    def _with_short_views(self, chooser: ViewChooser, found: _Candidates) -> _Candidates:
        """Adds views of what too few candidates see, as long as that helps."""
        settings = self._settings
        for number in range(_SHORT_ROUNDS):
            short = some_of(chooser.samples, chooser.short(found.matrix))
            places = thinned(short.points, self._frame, _SHORT_GRID_RATIO * settings.field_radius_m)
            if not len(places):
                break
            if number == 0:
                poses = self._views(short.points[places], _SHORT_TILTS_RAD, _SHORT_SIDES)
            else:
                # From now on by their own normals: walls and rims that no averaged view sees.
                poses = self._kept(
                    views_about(
                        short.points[places],
                        short.normals[places],
                        self._frame,
                        settings.standoff_m,
                        [share * settings.incidence_max_rad for share in _RIM_SHARES],
                        _SHORT_SIDES,
                    )
                )
            poses = poses.take(
                enough(chooser.matrix(poses, short), _CHOICES * settings.least_views)
            )
            beside_them = self._kept(shifted(poses, _SHIFT_RATIO * settings.field_radius_m))
            found = self._extended(chooser, found, Poses.joined([poses, beside_them]))
        return found

    def _views(self, places: Array, tilts_rad: tuple[float, ...], sides: int) -> Poses:
        standoff = self._settings.standoff_m
        return self._kept(
            viewpoints(self._surface, places, self._frame, standoff, tilts_rad, sides)
        )

    def _kept(self, poses: Poses) -> Poses:
        """Leaves out poses too near to the part."""
        if not len(poses):
            return poses
        far = self._clearance.distance(poses.positions) >= self._settings.clearance_m - 1e-9
        return poses.take(far)

    def _short_samples(
        self, chooser: ViewChooser, found: _Candidates, choice: Choice, checked: SurfaceSamples
    ) -> tuple[ViewChooser, _Candidates] | None:
        """Adds checked samples that are seen too seldom and could be seen more; None without."""
        poses = choice.poses
        views = visible(checked, self._caster, poses.positions, poses.directions, self._scanner)
        short = np.flatnonzero(views < self._settings.least_views)
        if not len(short):
            return None
        # Evenly picked: neighbours are short for the same reason.
        picked = short[:: max(1, len(short) // _MOST_ADDED)]
        more = some_of(checked, picked)
        matrix = chooser.matrix(found.poses, more)
        could = chooser.demand(matrix) > views[picked]
        share = float(could.sum()) / len(picked) * len(short) / len(checked.points)
        if share <= _SHORT_AREA_RATIO:
            return None
        extended = chooser.extended(some_of(more, could))
        return extended, _Candidates(found.poses, below(found.matrix, matrix[could]))

    def _as_path(self, choice: Choice) -> ScanPath:
        """Puts the chosen poses into the order of a scan path: passes, then viewpoints."""
        poses = choice.poses
        single = poses.passes == SINGLE
        groups = np.where(single, self._nearest_region(poses.targets), 0)
        groups[~single] = np.unique(poses.passes[~single], return_inverse=True)[1].reshape(-1)
        order = np.lexsort((np.arange(len(poses)), np.where(single, groups, 0), single))
        poses = poses.take(order)
        return ScanPath(
            positions=poses.positions,
            directions=poses.directions,
            targets=poses.targets,
            kinds=np.where(poses.passes == SINGLE, FEATURE, ROW),
            groups=groups[order],
            strategy="coverage",
            regions=int(self._regions.max(initial=0)),
            lower_bound=choice.lower_bound,
        )

    def _nearest_region(self, targets: Array) -> NDArray[np.int64]:
        """Returns the complex region nearest to each target; 1 on a part without any."""
        faces = np.flatnonzero(self._regions > 0)
        if not len(faces):
            return np.ones(len(targets), dtype=np.int64)
        tree = cKDTree(self._mesh.centroids[faces])
        return self._regions[faces[tree.query(targets)[1]]]
