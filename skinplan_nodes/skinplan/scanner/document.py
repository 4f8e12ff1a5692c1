"""A coverage certificate as plain data, ready for JSON."""

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from skinplan.scanner.facet_states import facet_states, unseen_facets
from skinplan.scanner.figures import RegionFigures, all_figures, sampling_error
from skinplan.scanner.model import Coverage
from skinplan.scanner.sight import SIGHT_NAMES


def coverage_document(coverage: Coverage, with_facets: bool = True) -> dict[str, Any]:
    """Returns a certificate as plain data; unknown numbers (NaN) are None.

    Keys: ``scanner``, ``least_views``, ``samples{count, spacing_m, error_ratio}``,
    ``regions[{name, area_m2, seen_ratio, ..., incidence_axis, incidence_ray, area_by_state_m2}]``
    with the whole part first, and ``unseen_facets[{state, reason, faces, seen_ratios}]``.

    Args:
        coverage: The certificate.
        with_facets: Whether to list the facets that are not seen.

    Returns:
        Dictionaries, lists, texts, numbers and None only.
    """
    samples = coverage.samples
    count = len(samples.points)
    spacing = math.sqrt(float(samples.weights.mean())) if count else math.nan
    names = facet_states(coverage).names if with_facets else None
    document: dict[str, Any] = {
        "scanner": asdict(coverage.scanner),
        "least_views": coverage.least_views,
        "samples": {
            "count": count,
            "spacing_m": spacing,
            "error_ratio": sampling_error(coverage),
        },
        "regions": [_region(figures) for figures in all_figures(coverage)],
    }
    if names is not None:
        document["unseen_facets"] = _facets(coverage, names)
    return _plain(document)


def _region(figures: RegionFigures) -> dict[str, Any]:
    return {
        "name": figures.name,
        "area_m2": figures.area_m2,
        "seen_ratio": figures.seen_ratio,
        "often_seen_ratio": figures.often_seen_ratio,
        "seeable_ratio": figures.seeable_ratio,
        "seen_of_seeable_ratio": figures.seen_of_seeable_ratio,
        "often_seen_of_seeable_ratio": figures.often_seen_of_seeable_ratio,
        "incidence_axis": asdict(figures.axis),
        "incidence_ray": asdict(figures.ray),
        "area_by_state_m2": dict(zip(SIGHT_NAMES, figures.areas_m2, strict=True)),
    }


def _facets(coverage: Coverage, names: tuple[str, ...]) -> list[dict[str, Any]]:
    found = unseen_facets(coverage)
    groups = []
    for sight, reason in np.unique(np.column_stack([found.sights, found.reasons]), axis=0):
        among = (found.sights == sight) & (found.reasons == reason)
        groups.append(
            {
                "state": names[sight],
                "reason": names[reason],
                "faces": found.faces[among],
                "seen_ratios": np.round(found.seen_ratios[among], 4),
            }
        )
    return groups


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list):
        return [_plain(each) for each in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
