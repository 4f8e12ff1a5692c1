"""Clouds of dented parts as the mock scanner and tracker measure them."""

import numpy as np
from scipy.spatial.transform import Rotation

from skinplan.inspection.merge import MergedCloud
from skinplan.mesh.model import SurfaceMesh
from skinplan.mock.scanner import MockScanner
from skinplan.mock.tracker import MockTracker
from skinplan.part.model import ScanSettings
from skinplan.scanner.model import ScannerModel
from skinplan.transforms import apply, transform

# The tracker looks along +x at the part, whose outside looks back.
T_TRACKER_WORKPIECE = transform((3.1, 0.25, -0.08), [[0, 0, -1], [1, 0, 0], [0, -1, 0]])
_DOWN = [[0, 1, 0], [0, 0, -1], [-1, 0, 0]]


def dented(mesh, *dents):
    """The mesh with its surface moved along its normals by `height` inside circles (x, y, r)."""
    vertices, normals = mesh.vertices.copy(), mesh.vertex_normals
    for x, y, radius, height in dents:
        inside = np.hypot(vertices[:, 0] - x, vertices[:, 1] - y) < radius
        vertices[inside] += height * normals[inside]
    return SurfaceMesh(vertices, mesh.faces)


def scanned(mesh, seed, step_m=0.03, pitch_m=0.1, volumetric_m=0.0, voxel_m=0.001):
    """The merged cloud of frames on rows over the mesh, tracker frame, with the devices' noise."""
    scanner = MockScanner(mesh, ScannerModel.from_settings(ScanSettings()), seed)
    tracker = MockTracker(np.eye(4), seed, volumetric_m=volumetric_m)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    cloud = MergedCloud(voxel_m, 3_000_000)
    for y in np.arange(low[1], high[1] + pitch_m / 2, pitch_m):
        for x in np.arange(low[0], high[0] + step_m / 2, step_m):
            pose = transform((x, y, 0.3), _DOWN)
            points = scanner.frame(pose).points
            cloud.add(apply(tracker.measure(T_TRACKER_WORKPIECE @ pose), points))
    return cloud.points()[0]


def off_by(position_m, angle_deg, seed=0):
    """A pose that is off by so much in a drawn direction."""
    rng = np.random.default_rng(seed)
    shift, axis = rng.normal(size=(2, 3))
    turn = Rotation.from_rotvec(np.deg2rad(angle_deg) * axis / np.linalg.norm(axis)).as_matrix()
    return transform(position_m * shift / np.linalg.norm(shift), turn)
