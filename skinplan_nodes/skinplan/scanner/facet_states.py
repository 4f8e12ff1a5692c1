"""The facets of a coverage certificate: their states, colours, and the list of those not seen."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skinplan.scanner.model import Coverage
from skinplan.scanner.sight import SIGHT_COLOURS, SIGHT_NAMES, Sight
from skinplan.transforms import Array


class FacetStates(NamedTuple):
    """States of all facets, ready to be drawn.

    Attributes:
        codes: `Sight` of each facet, shape (f,); -1 = not judged (a part without area).
        names: What each code means, for a legend; entry i belongs to code i.
        colours: Red, green, blue of each code, shape (8, 3), 0 to 255.
    """

    codes: NDArray[np.int8]
    names: tuple[str, ...]
    colours: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class UnseenFacets:
    """The facets that are not seen, or not all of which is seen.

    Attributes:
        faces: Face numbers, ascending, shape (u,).
        sights: `Sight` of each, shape (u,).
        reasons: `Sight` by the views alone, shape (u,): the cause where the sight is
            CANNOT_BE_SEEN.
        seen_ratios: Share of the facet's samples that is seen [1], shape (u,); 0 for a facet
            without a sample of its own.
    """

    faces: NDArray[np.int64]
    sights: NDArray[np.int8]
    reasons: NDArray[np.int8]
    seen_ratios: Array


def facet_states(coverage: Coverage) -> FacetStates:
    """Returns the states of the facets of a certificate, with names and colours.

    Args:
        coverage: The certificate.

    Returns:
        The states.
    """
    names = list(SIGHT_NAMES)
    least = coverage.least_views
    names[Sight.SEEN_OFTEN] = f"seen {least} times or more"
    names[Sight.SEEN] = f"seen, less than {least} times"
    colours = np.array(SIGHT_COLOURS, dtype=np.uint8)
    return FacetStates(coverage.facet_sights, tuple(names), colours)


def unseen_facets(coverage: Coverage) -> UnseenFacets:
    """Lists the facets that are not seen, with the reasons.

    Args:
        coverage: The certificate.

    Returns:
        The facets.
    """
    sights = coverage.facet_sights
    faces = np.flatnonzero(sights > Sight.SEEN)
    owners = coverage.samples.faces
    count = np.bincount(owners, minlength=len(sights))[faces]
    seen = np.bincount(owners[coverage.views > 0], minlength=len(sights))[faces]
    ratios = np.divide(seen, count, out=np.zeros(len(faces)), where=count > 0)
    return UnseenFacets(faces, sights[faces], coverage.facet_reasons[faces], ratios)
