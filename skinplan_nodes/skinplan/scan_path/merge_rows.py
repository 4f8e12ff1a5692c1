"""Makes the rows of neighbouring patches and parts one where that saves turns (R 5)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import MeshRefusedError
from skinplan.scan_path.frame import RowFrame, candidate_frames, given_frame, is_across
from skinplan.scan_path.partition import mean_normal
from skinplan.scan_path.patch_rows import PatchRows, RowRule, lay_rows
from skinplan.scan_path.view_choice import joined
from skinplan.scanner.model import SurfaceSamples
from skinplan.transforms import Array

# Patches share rows when no more than this share of what the own direction of each has within the
# patch angle is outside it in the common one.
_LOST_RATIO = 0.01
_LEAST_SAVING_M = 1e-6
_DIRECTION_DIGITS = 9


@dataclass(frozen=True, eq=False)
class RowGroup:
    """Patches that share rows.

    Attributes:
        samples: Samples of the patches; their normals are those of the smoothed surface.
        rows: The rows.
        patches: Patch of each sample, from 0, rising, shape (n,).
        within_m2: Area of each patch within the patch angle of its own mean normal [m^2].
        normals: Mean normal of each patch, unit, shape (p, 3).
    """

    samples: SurfaceSamples
    rows: PatchRows
    patches: NDArray[np.int64]
    within_m2: Array
    normals: Array

    @cached_property
    def area_m2(self) -> float:
        """Area of the patches [m^2]."""
        return float(self.samples.weights.sum())

    @cached_property
    def total(self) -> Array:
        """Sum of all facets' normals weighted by area, shape (3,) [m^2]."""
        return np.asarray(self.samples.weights @ self.samples.normals)


class RowMerger:
    """Lays rows over patches, and merges them greedily, the largest saving first."""

    def __init__(
        self,
        rule: RowRule,
        angle_rad: float,
        direction: tuple[float, float, float] | None,
    ) -> None:
        """Keeps the figures.

        Args:
            rule: How rows are laid; ``gap_m`` is also how far apart neighbours may be.
            angle_rad: Largest angle between facets and the direction of their rows [rad].
            direction: Direction of the rows that is asked for; None = the one of least cost.
        """
        self._rule, self._cosine, self._direction = rule, float(np.cos(angle_rad)), direction

    def alone(self, samples: SurfaceSamples) -> RowGroup | None:
        """Lays rows over one patch; None where it is a line, or has no mean normal."""
        base = mean_normal(samples.normals, samples.weights)
        if base is None:
            return None
        rows = self._rows(samples, base, ())
        patches = np.zeros(len(samples.points), dtype=np.int64)
        within = self._within(samples, patches, base)
        return None if rows is None else RowGroup(samples, rows, patches, within, base[None])

    def merged(self, groups: list[RowGroup]) -> list[RowGroup]:
        """Merges groups as long as that makes rows and turns shorter.

        Args:
            groups: Rows of single patches.

        Returns:
            The groups, merged ones in the place of their first.
        """
        if self._rule.gap_m <= 0.0 or len(groups) < 2:
            return groups
        alive: dict[int, RowGroup] = dict(enumerate(groups))
        near = self._neighbours(groups)
        options = {pair: self._union(alive, *pair) for pair in sorted(near)}
        while True:
            chosen = _best(alive, options)
            if not chosen:
                return [alive[number] for number in sorted(alive)]
            for pair in chosen:
                union = options[pair]
                assert union is not None
                alive[pair[0]] = union
                del alive[pair[1]]
            keeper = {gone: keep for keep, gone in chosen}
            near = {_renamed(pair, keeper) for pair in near if pair not in chosen}
            changed = {keep for keep, _ in chosen}
            options = {
                pair: self._union(alive, *pair) if changed & {*pair} else options[pair]
                for pair in sorted(near)
            }

    def _union(self, alive: dict[int, RowGroup], first: int, second: int) -> RowGroup | None:
        """Lays rows over two groups; None where one direction can't treat both."""
        pair = alive[first], alive[second]
        total = pair[0].total + pair[1].total
        base = total / max(float(np.linalg.norm(total)), 1e-12)
        normals = np.concatenate([group.normals for group in pair])
        if np.any(normals @ base < self._cosine):
            return None
        samples = joined([group.samples for group in pair])
        patches = np.concatenate([pair[0].patches, pair[1].patches + len(pair[0].within_m2)])
        wanted = np.concatenate([group.within_m2 for group in pair])
        if np.any(self._within(samples, patches, base) < (1.0 - _LOST_RATIO) * wanted):
            return None
        # The rows' direction of each, weighted by its area.
        aligned = [group.area_m2 * group.rows.frame.along for group in pair]
        turned = 1.0 if aligned[0] @ aligned[1] >= 0.0 else -1.0
        rows = self._rows(samples, base, (aligned[0] + turned * aligned[1],))
        return None if rows is None else RowGroup(samples, rows, patches, wanted, normals)

    def _rows(
        self, samples: SurfaceSamples, base: Array, further: tuple[Array, ...]
    ) -> PatchRows | None:
        """Lays rows in the direction of least cost; None where the samples are a line."""
        frames = self._frames(samples, base, further)
        if not frames:
            return None
        options = [lay_rows(samples, frame, self._rule) for frame in frames]
        return options[int(np.argmin([round(option.cost_m, 6) for option in options]))]

    def _frames(
        self, samples: SurfaceSamples, base: Array, further: tuple[Array, ...]
    ) -> list[RowFrame]:
        if self._direction is not None and not is_across(base, self._direction):
            return [given_frame(base, self._direction)]
        # A wall across the rows that are asked for has a direction of its own.
        try:
            frames = list(candidate_frames(samples.points, base, samples.weights))
        except MeshRefusedError:
            return []
        for direction in further:
            flat = direction - (direction @ base) * base
            length = float(np.linalg.norm(flat))
            if length > 1e-9:
                along = np.round(flat / length, _DIRECTION_DIGITS)
                frames.append(RowFrame(along, np.cross(base, along), base))
        return frames

    def _within(self, samples: SurfaceSamples, patches: NDArray[np.int64], base: Array) -> Array:
        """Returns the area of each patch within the patch angle of a direction, shape (p,)."""
        inside = samples.weights * (samples.normals @ base >= self._cosine)
        return np.asarray(np.bincount(patches, weights=inside), dtype=np.float64)

    def _neighbours(self, groups: list[RowGroup]) -> set[tuple[int, int]]:
        """Returns the pairs of groups whose samples come near enough to each other."""
        trees = [cKDTree(group.samples.points) for group in groups]
        lows = np.stack([tree.mins for tree in trees])
        highs = np.stack([tree.maxes for tree in trees])
        reach = self._rule.gap_m + max(
            float(np.sqrt(group.samples.weights.max())) for group in groups
        )
        found = set()
        for number, tree in enumerate(trees):
            apart = np.maximum(lows - highs[number], lows[number] - highs).max(axis=1)
            for other in np.flatnonzero(apart <= reach):
                if other > number and _near(tree, trees[other], reach):
                    found.add((number, int(other)))
        return found


def _near(first: cKDTree, second: cKDTree, reach_m: float) -> bool:
    """Says whether two sets of points come within reach of each other."""
    asked, held = (first, second) if first.n < second.n else (second, first)
    gaps: NDArray[np.float64] = held.query(asked.data, distance_upper_bound=reach_m)[0]
    return bool(np.isfinite(gaps).any())


def _best(
    alive: dict[int, RowGroup], options: dict[tuple[int, int], RowGroup | None]
) -> list[tuple[int, int]]:
    """Returns pairs that save at least one row, the largest saving first, no group in two."""
    savings = []
    for pair, union in options.items():
        if union is None:
            continue
        first, second = (alive[number].rows for number in pair)
        saved = first.cost_m + second.cost_m - union.rows.cost_m
        fewer = len(first.members) + len(second.members) > len(union.rows.members)
        if fewer and saved > _LEAST_SAVING_M:
            savings.append((-round(saved, 6), pair))
    taken: set[int] = set()
    chosen = []
    for _, pair in sorted(savings):
        if not taken & {*pair}:
            taken |= {*pair}
            chosen.append(pair)
    return chosen


def _renamed(pair: tuple[int, int], keeper: dict[int, int]) -> tuple[int, int]:
    first, second = (keeper.get(number, number) for number in pair)
    return (first, second) if first < second else (second, first)
