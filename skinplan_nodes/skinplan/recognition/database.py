"""Descriptors of the models' rendered views on disk, and the nearest of them (R2.3).

Histograms are compared by the square roots of their bins (Hellinger's distance): a KD-tree works
with Euclidean distances, and a few percent in an empty bin count more than in a full one.
"""

import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import InputError
from skinplan.recognition.twins import embedded, model_hash, twins
from skinplan.recognition.vfh import BINS
from skinplan.transforms import Array
from skinplan.whole_file import whole_file

_VERSION = 1
_KEYS = ("version", "names", "hashes", "model", "rest", "descriptors")

#: How a model can lie: as it was made, or turned over.
RESTS = ("upright", "upside down")


@dataclass(frozen=True)
class MatchSettings:
    """When a descriptor belongs to a model.

    Attributes:
        distance_max: To the nearest view; farther ones are of no known part [1].
        alike_ratio: Models within this many times the least distance are alike [1].
        alike_distance: Distances below this can't be told apart [1].
    """

    distance_max: float = 0.22
    alike_ratio: float = 1.3
    alike_distance: float = 0.02


@dataclass(frozen=True)
class Match:
    """What a descriptor shows.

    Attributes:
        name: The model; None = unknown, or several are alike.
        alike: Models that this can't be told from by its descriptor; empty without any.
        rest: How the nearest view lies, of `RESTS`.
        distance: To the nearest view [1].
        distances: Least distance to each model [1].
        reason: The answer as a sentence.
    """

    name: str | None
    alike: tuple[str, ...]
    rest: str
    distance: float
    distances: dict[str, float] = field(default_factory=dict)
    reason: str = ""


@dataclass(frozen=True, eq=False)
class ModelDatabase:
    """Views of models.

    Attributes:
        names: Of the models, shape (m,).
        hashes: Of their shapes.
        model: Number of the model of each view, shape (v,).
        rest: How it lies in the view, number in `RESTS`, shape (v,).
        descriptors: shape (v, 308).
        twins: Pairs of models that are mirror images or the same shape.
    """

    names: tuple[str, ...]
    hashes: tuple[str, ...]
    model: NDArray[np.int64]
    rest: NDArray[np.int64]
    descriptors: Array
    twins: tuple[tuple[str, str, str], ...] = ()

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(embedded(self.descriptors))

    def match(self, descriptor: Array, settings: MatchSettings | None = None) -> Match:
        """Says which model a descriptor shows.

        Args:
            descriptor: shape (308,).
            settings: When it belongs to one.

        Returns:
            The answer; no known model is no error.

        Raises:
            InputError: Another shape, or values that are not finite.
        """
        settings = settings or MatchSettings()
        wanted = np.asarray(descriptor, dtype=float)
        if wanted.shape != (BINS,) or not np.isfinite(wanted).all():
            raise InputError(
                f"a descriptor of shape ({BINS},) with finite values is accepted, found "
                f"{wanted.shape}"
            )
        away, order = self._tree.query(embedded(wanted), k=len(self.model))
        away, order = np.atleast_1d(away), np.atleast_1d(order)
        distances: dict[str, float] = {}
        for distance, view in zip(away, order, strict=True):
            distances.setdefault(self.names[self.model[view]], float(distance))
        rest = RESTS[self.rest[order[0]]]
        return self._answer(distances, rest, settings)

    def _answer(self, distances: dict[str, float], rest: str, settings: MatchSettings) -> Match:
        best, least = next(iter(distances.items()))
        if least > settings.distance_max:
            reason = (
                f"unknown part: the nearest model is {best} at a distance of {least:.3f}, at most "
                f"{settings.distance_max:.3f} is accepted"
            )
            return Match(None, (), rest, least, distances, reason)
        alike = self.alike(distances, settings)
        if len(alike) > 1:
            kinds = [
                f"{first} and {second} are {kind}"
                for first, second, kind in self.twins
                if best in (first, second)
            ]
            why = f" ({'; '.join(kinds)})" if kinds else ""
            reason = f"{' and '.join(alike)} can't be told apart by their descriptors{why}"
            return Match(None, alike, rest, least, distances, reason)
        reason = f"{best}, {rest}, at a distance of {least:.3f}"
        return Match(best, (), rest, least, distances, reason)

    def alike(self, distances: Mapping[str, float], settings: MatchSettings) -> tuple[str, ...]:
        """Names of the nearest model, of those about as near, and of its twins.

        Args:
            distances: Least distance to each model, of a `Match` [1].
            settings: Which are about as near.
        """
        best = min(distances, key=lambda name: distances[name])
        limit = max(settings.alike_distance, settings.alike_ratio * distances[best])
        alike = [name for name, distance in distances.items() if distance <= limit]
        for first, second, _ in self.twins:
            if best in (first, second):
                alike += [name for name in (first, second) if name not in alike]
        return tuple(alike)

    def check(self, models: Mapping[str, trimesh.Trimesh]) -> None:
        """Makes sure that the database was made of these models.

        Raises:
            InputError: A model is missing, or its shape is another one.
        """
        known = dict(zip(self.names, self.hashes, strict=True))
        if missing := sorted(set(models) - set(known)):
            raise InputError(
                f"models were to be recognised; the database has none of {', '.join(missing)}, "
                "one that was built of all models is accepted"
            )
        if other := sorted(name for name in models if known[name] != model_hash(models[name])):
            raise InputError(
                f"the database was built of another shape of {', '.join(other)}; one that was "
                "built of these models is accepted"
            )

    def save(self, path: Path) -> None:
        """Writes the database as one file (.npz); a reader sees the old or the new one."""
        with whole_file(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(
                stream,
                version=np.array(_VERSION),
                names=np.array(self.names),
                hashes=np.array(self.hashes),
                model=self.model,
                rest=self.rest,
                descriptors=self.descriptors,
                twins=np.array(self.twins, dtype=str).reshape(-1, 3),
            )

    @classmethod
    def load(cls, path: Path) -> "ModelDatabase":
        """Reads a database.

        Raises:
            InputError: No such file, or it is no database of this version.
        """
        try:
            with np.load(path, allow_pickle=False) as data:
                values = {key: data[key] for key in (*_KEYS, "twins")}
        except FileNotFoundError:
            raise InputError(f"{path}: a database of models is accepted, found no file") from None
        except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(f"{path}: a database of models is accepted, found {error}") from None
        return cls._checked(path, values)

    @classmethod
    def _checked(cls, path: Path, values: dict[str, NDArray]) -> "ModelDatabase":
        views, models = len(values["model"]), len(values["names"])
        fits = (
            int(values["version"]) == _VERSION
            and values["descriptors"].shape == (views, BINS)
            and values["rest"].shape == (views,)
            and len(values["hashes"]) == models
            and views > 0
            and bool(np.isin(values["model"], np.arange(models)).all())
            and bool(np.isin(values["rest"], np.arange(len(RESTS))).all())
            and bool(np.isfinite(values["descriptors"]).all())
        )
        if not fits:
            raise InputError(
                f"{path}: a database of models of version {_VERSION} is accepted, found values "
                "that do not fit each other"
            )
        return cls(
            tuple(str(name) for name in values["names"]),
            tuple(str(each) for each in values["hashes"]),
            values["model"].astype(np.int64),
            values["rest"].astype(np.int64),
            values["descriptors"].astype(float),
            tuple((str(a), str(b), str(kind)) for a, b, kind in values["twins"]),
        )


def build(
    models: Mapping[str, trimesh.Trimesh], views: Iterable[tuple[str, str, Array]]
) -> ModelDatabase:
    """Puts descriptors of rendered views together.

    Args:
        models: By name.
        views: Model, rest (of `RESTS`) and descriptor of each view.

    Returns:
        The database, with the twins among the models.

    Raises:
        InputError: No views, or one of an unknown model or rest.
    """
    names = tuple(models)
    found = list(views)
    if not found:
        raise InputError("a database was to be built; at least one view is accepted, found none")
    for name, rest, _ in found:
        if name not in models or rest not in RESTS:
            raise InputError(
                f"a view of {name!r}, {rest!r}, was given; models {', '.join(names)} and rests "
                f"{', '.join(RESTS)} are accepted"
            )
    database = ModelDatabase(
        names,
        tuple(model_hash(models[name]) for name in names),
        np.array([names.index(name) for name, _, _ in found]),
        np.array([RESTS.index(rest) for _, rest, _ in found]),
        np.stack([descriptor for _, _, descriptor in found]),
    )
    return ModelDatabase(
        database.names,
        database.hashes,
        database.model,
        database.rest,
        database.descriptors,
        twins(models, database.names, database.model, database.descriptors),
    )
