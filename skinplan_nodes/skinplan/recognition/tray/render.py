"""Views of models as the fine scan of the tray would show them, without noise."""

from collections.abc import Iterator, Mapping

import numpy as np
import trimesh

from skinplan.recognition.database import RESTS, ModelDatabase, build
from skinplan.recognition.part_cloud import CutSettings, PartCloud, Place, part_cloud
from skinplan.recognition.planes import Plane
from skinplan.recognition.tray.camera import CameraSettings, Scene, moved
from skinplan.recognition.tray.layout import resting
from skinplan.recognition.tray.scan import ScanSettings, fine_scan
from skinplan.transforms import Array

_TRAY = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 1.0, 0.0)
_MARGIN_M = 0.01


def model_views(
    models: Mapping[str, trimesh.Trimesh],
    headings: int = 9,
    cut: CutSettings | None = None,
    scan: ScanSettings | None = None,
) -> Iterator[tuple[str, str, Array]]:
    """Renders each model in both rests.

    Views from the sides are spread evenly about the part, so that headings within one step between
    them are enough.

    Args:
        models: By name.
        headings: So many of each rest.
        cut: How parts are cut out of clouds.
        scan: The views of the fine scan.

    Yields:
        Model, rest and descriptor.
    """
    cut = cut or CutSettings()
    scan = scan or ScanSettings()
    step = 2.0 * np.pi / max(scan.side_views, 1) / headings
    for name, mesh in models.items():
        for rest in RESTS:
            for turn in range(headings):
                cloud = rendered(mesh, (turn + 0.5) * step, rest == RESTS[1], cut, scan)
                yield name, rest, cloud.descriptor(cut)


def rendered(
    mesh: trimesh.Trimesh,
    heading_rad: float,
    upside_down: bool,
    cut: CutSettings | None = None,
    scan: ScanSettings | None = None,
) -> PartCloud:
    """The cloud that a part alone on the tray would give, without noise [m]."""
    cut = cut or CutSettings()
    scan = scan or ScanSettings()
    body = moved(mesh, resting(mesh, heading_rad, upside_down))
    place = Place.of(np.asarray(body.vertices))
    perfect = ScanSettings(
        fine_step_m=scan.fine_step_m,
        side_views=scan.side_views,
        tilt_rad=scan.tilt_rad,
        camera=CameraSettings(noise_m=0.0, edge_ratio=0.0),
    )
    views = fine_scan(
        Scene([body]),
        place.middle,
        place.radius_m + _MARGIN_M,
        np.random.default_rng(0),
        perfect,
    )
    return part_cloud(
        [view.points for view in views], [view.seen_from for view in views], _TRAY, place, cut
    )


def render_database(
    models: Mapping[str, trimesh.Trimesh], headings: int = 9, cut: CutSettings | None = None
) -> ModelDatabase:
    """Builds the database of models."""
    return build(models, model_views(models, headings, cut))
