"""Models that descriptors can't tell apart: mirror images, and one shape under two names."""

import hashlib
from collections.abc import Mapping, Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.recognition.vfh import SECTIONS
from skinplan.transforms import Array

# Volumes and areas of twins agree to this share [1].
_SAME_SIZE = 1e-3


def model_hash(mesh: trimesh.Trimesh) -> str:
    """Hash of a model's shape over whole micrometres, hex."""
    digest = hashlib.sha256()
    digest.update(np.rint(np.asarray(mesh.vertices) * 1e6).astype("<i8").tobytes())
    digest.update(np.asarray(mesh.faces).astype("<i8").tobytes())
    return digest.hexdigest()


def embedded(descriptors: Array) -> Array:
    """Square roots of the bins, scaled so that the distance of two descriptors is at most 1."""
    return np.asarray(np.sqrt(descriptors / (2.0 * 100.0 * len(SECTIONS))))


def mirrored(descriptors: Array) -> Array:
    """Descriptors of the mirror images, shape (..., 308): only alpha changes its sign."""
    turned = descriptors.copy()
    turned[..., SECTIONS[1]] = descriptors[..., SECTIONS[1]][..., ::-1]
    return np.asarray(turned)


def twins(
    models: Mapping[str, trimesh.Trimesh],
    names: Sequence[str],
    model: NDArray[np.int64],
    descriptors: Array,
    alike: float = 0.1,
) -> tuple[tuple[str, str, str], ...]:
    """Finds pairs of twins among models.

    Args:
        models: By name.
        names: Of the models, in the order of their numbers.
        model: Number of the model of each view, shape (v,).
        descriptors: Of the views, shape (v, 308).
        alike: Views nearer than this are alike [1].

    Returns:
        Two names and what they are to each other.
    """
    found = []
    views, mirror = embedded(descriptors), embedded(mirrored(descriptors))
    for i, first in enumerate(names):
        for j in range(i + 1, len(names)):
            second = names[j]
            mine, theirs = model == i, model == j
            if not (mine.any() and theirs.any() and _same_size(models[first], models[second])):
                continue
            other = cKDTree(views[theirs])
            same = float(other.query(views[mine])[0].max())
            flipped = float(other.query(mirror[mine])[0].max())
            if min(same, flipped) < alike:
                kind = "of the same shape" if same <= flipped else "mirror twins"
                found.append((first, second, kind))
    return tuple(found)


def _same_size(one: trimesh.Trimesh, other: trimesh.Trimesh) -> bool:
    figures = np.array([[mesh.volume, mesh.area] for mesh in (one, other)])
    return bool(np.all(np.abs(figures[0] - figures[1]) <= _SAME_SIZE * np.abs(figures[0])))
