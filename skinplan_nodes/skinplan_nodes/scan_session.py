"""What a scan has measured so far: the merged cloud, the coarse pose of the part, the coverage.

Needs no ROS.
"""

import threading
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import AlignmentError, NoCloudError
from skinplan.inspection.cloud import write_ply
from skinplan.inspection.coverage import CoverageSoFar
from skinplan.inspection.measure import InspectionSettings, coverage_so_far, inspect
from skinplan.inspection.merge import MergedCloud
from skinplan.inspection.model import Inspection
from skinplan.inspection.results import write_results
from skinplan.inspection.spool import FrameSpool
from skinplan.inspection.spool_records import FrameRecord, HiddenRecord, PoseRecord, Record
from skinplan.mesh.prepare import PreparedMesh
from skinplan.part.model import Part
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array, apply, inverse, rotate
from skinplan_nodes.coarse_pose import CoarsePose

# intensity, incidence, view direction x y z
_COLUMNS = 5


@dataclass(frozen=True)
class SessionSettings:
    """How a scan is merged and judged.

    Attributes:
        voxel_m: One point is kept per voxel [m].
        points_max: At most so many points are kept.
        coverage_spacing_m: Spacing of the surface samples [m].
        coverage_radius_m: A sample counts as measured when a point lies within [m].
    """

    voxel_m: float = 0.001
    points_max: int = 3_000_000
    coverage_spacing_m: float = 0.005
    coverage_radius_m: float = 0.008


@dataclass(frozen=True)
class Progress:
    """How far a scan is.

    Attributes:
        frames: Scan frames received.
        frames_hidden: Frames left out because the tracker did not see the scanner.
        frames_out_of_range: Frames of which points beyond range or incidence limit were left out.
        points: Points kept; those of the last frames are counted before they are merged.
        area_ratio: Share of the area seen [1]; NaN while the part is not located.
        feature_area_ratio: Same, complex regions only; NaN without any.
    """

    frames: int
    frames_hidden: int
    frames_out_of_range: int
    points: int
    area_ratio: float
    feature_area_ratio: float


@dataclass(frozen=True, eq=False)
class _Inspected:
    """The last inspection, and how many points and estimates of the place it was made from."""

    received: tuple[int, int]
    inspection: Inspection
    coverage: CoverageSoFar


@dataclass(eq=False)
class _Waiting:
    """Points that the coverage has not seen yet."""

    points: list[Array] = field(default_factory=list)
    directions: list[Array] = field(default_factory=list)


class ScanSession:
    """One scan of one part; its methods may be called from any thread.

    Args:
        job_id: Job that it belongs to.
        prepared: The part's mesh and complex regions.
        settings: How to merge and judge.
        spool: Keeps on disk what is taken in; None = in memory only.
        part: Says what the part is judged by; None = nothing.
    """

    def __init__(
        self,
        job_id: str,
        prepared: PreparedMesh,
        settings: SessionSettings,
        spool: FrameSpool | None = None,
        part: Part | None = None,
    ) -> None:
        self.job_id = job_id
        self._part = part
        self._last: _Inspected | None = None
        self._prepared = prepared
        self._settings = settings
        self._spool = spool
        self._lock = threading.Lock()
        self._cloud = MergedCloud(settings.voxel_m, settings.points_max, _COLUMNS)
        self._coarse = CoarsePose()
        self._coverage = self._empty_coverage()
        self._waiting = _Waiting()
        self._frames = self._hidden = self._partial = 0

    @property
    def frames(self) -> int:
        """Number of frames taken in."""
        return self._frames

    @property
    def spool_failure(self) -> str:
        """Why frames are no longer kept on disk; empty = they are, or were never meant to be."""
        return "" if self._spool is None else self._spool.failure

    def restore(self, records: Iterable[Record]) -> None:
        """Takes in what an earlier process collected."""
        with self._lock:
            for record in records:
                if isinstance(record, FrameRecord):
                    self._take(record)
                elif isinstance(record, PoseRecord):
                    self._coarse.add(record.stand, record.T_tracker_workpiece)
                else:
                    self._hidden += 1

    def add_frame(self, frame: FrameRecord) -> None:
        """Takes a scan frame in.

        Raises:
            InputError: Points that can't be used.
        """
        with self._lock:
            self._take(frame)
            self._keep(frame)

    def add_hidden(self) -> None:
        """Counts a frame that the tracker did not see."""
        with self._lock:
            self._hidden += 1
            self._keep(HiddenRecord())

    @property
    def is_placed(self) -> bool:
        """Whether it is known where the part stands in the tracker frame."""
        with self._lock:
            return self._coarse.estimate() is not None

    def add_coarse(self, stand: float, T_tracker_workpiece: Array) -> None:
        """Takes an estimate of the part's pose in, see `CoarsePose`."""
        with self._lock:
            if self._coarse.add(stand, T_tracker_workpiece):
                self._keep(PoseRecord(stand, T_tracker_workpiece))

    def merged(self) -> Array:
        """Returns the merged cloud so far, tracker frame, shape (n, 3) [m]."""
        with self._lock:
            return self._cloud.points()[0]

    def close(self) -> None:
        """Ends keeping on disk; the file stays."""
        if self._spool is not None:
            self._spool.close()

    def progress(self) -> Progress:
        """Brings the coverage up to date and returns how far the scan is."""
        with self._lock:
            coarse = self._coarse.estimate()
            if coarse is not None:
                self._cover(inverse(coarse))
            known = coarse is not None
            return Progress(
                self._frames,
                self._hidden,
                self._partial,
                self._cloud.about,
                self._coverage.area_ratio if known else float("nan"),
                self._coverage.feature_area_ratio if known else float("nan"),
            )

    def finish(self, cloud: Path | None, final: bool = True) -> Inspection:
        """Aligns and measures the cloud and writes it; when that fails, the cloud as it came.

        Args:
            cloud: PLY to write, with ``deviation``, ``intensity`` and ``incidence``; beside it what
                `write_results` writes. None = not written.
            final: Also write what only a finished run needs.

        Raises:
            NoCloudError: No points.
            AlignmentError: It is not known where the part stands, or the cloud does not lie on it.
            CloudInvalidError: The file can't be written.
        """
        with self._lock:
            points, extra = self._cloud.points()
            coarse = self._coarse.estimate()
            received = self._cloud.received, self._coarse.count
            if self._spool is not None:
                self._spool.sync()
        if len(points) == 0:
            raise NoCloudError(
                f"job {self.job_id}: a cloud was asked for, but {self._frames} scan frames brought "
                f"no points"
            )
        if self._last is not None and self._last.received == received:
            # Nothing has come since the last inspection: it would find the same.
            inspection, coverage = self._last.inspection, self._last.coverage
        else:
            coverage = self._empty_coverage()
            try:
                inspection = self._inspected(points, extra, coarse, coverage)
            except Exception:
                if cloud is not None:
                    write_ply(cloud, points, "tracker", _values(extra))
                raise
            self._last = _Inspected(received, inspection, coverage)
        if cloud is not None:
            write_results(
                cloud,
                points,
                inspection,
                coverage,
                _values(extra),
                None if self._part is None else self._part.inspection,
                None if self._part is None else self._part.points,
                final,
            )
        return inspection

    def _inspected(
        self,
        points: Array,
        extra: NDArray[np.float32],
        coarse: Array | None,
        coverage: CoverageSoFar,
    ) -> Inspection:
        if coarse is None:
            raise AlignmentError(
                f"job {self.job_id}: it is not known where the part stands in the tracker frame; a "
                f"scan with localisation, joint states and scanner poses at one stand at least is "
                f"accepted"
            )
        spacing, radius = self._settings.coverage_spacing_m, self._settings.coverage_radius_m
        settings = replace(InspectionSettings(), spacing_m=spacing, radius_m=radius)
        mesh, segmentation = self._prepared.mesh, self._prepared.segmentation
        directions = extra[:, 2:5].astype(float)
        return inspect(points, mesh, segmentation, coarse, settings, directions, coverage)

    def _empty_coverage(self) -> CoverageSoFar:
        samples = sample_surface(self._prepared.mesh, self._settings.coverage_spacing_m)
        radius = self._settings.coverage_radius_m
        return coverage_so_far(samples, self._prepared.segmentation, radius)

    def _take(self, frame: FrameRecord) -> None:
        if len(frame.points):
            views = np.tile(frame.direction, (len(frame.points), 1))
            extra = np.column_stack([frame.intensity, frame.incidence, views]).astype(np.float32)
            self._cloud.add(frame.points, extra)
            self._waiting.points.append(frame.points)
            self._waiting.directions.append(views)
        self._frames += 1
        self._partial += frame.partial

    def _keep(self, record: Record) -> None:
        if self._spool is not None:
            self._spool.add(record)

    def _cover(self, T_workpiece_tracker: Array) -> None:
        waiting, self._waiting = self._waiting, _Waiting()
        if waiting.points:
            self._coverage.add(
                apply(T_workpiece_tracker, np.concatenate(waiting.points)),
                rotate(T_workpiece_tracker, np.concatenate(waiting.directions)),
            )


def _values(extra: NDArray[np.float32]) -> dict[str, Array]:
    return {"intensity": extra[:, 0].astype(float), "incidence": extra[:, 1].astype(float)}
