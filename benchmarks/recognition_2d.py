"""2-D recognition on the tray: what light does to it, and where parts are said to lie.

Run as ``python benchmarks/recognition_2d.py [--layouts N] [--picture FILE]``. Photos of random
layouts of the nine parts (1296 x 1024 px, 79.6 degrees, 1.3 m over the tray), under even and uneven
light, with and without compensation. Of each: outlines of the right class, outlines of a wrong one,
parts not found or of no class, outlines where no part is; and how far the place is off, of parts
whose class is one type, and of the outline's own centre. A refused photo counts none.
"""

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from skinplan.errors import ImageInvalidError
from skinplan.recognition.tray.layout import TRAY_SIZE_M, PlacedPart, layout
from skinplan.recognition.tray.parts import MAKERS, part_mesh
from skinplan.recognition.tray.photo import Image, Light, Photographer, camera_above
from skinplan.recognition.tray_classes import Classifier, TrayFinding
from skinplan.recognition.tray_image import BlobSettings, blobs
from skinplan.recognition.tray_view import TrayView
from skinplan.transforms import Array

# A sighting farther from a part than this is not of it.
_NEAR_M = 0.06
EVEN = Light()
# Light of the photo with parts, and of that of the empty tray.
CASES: dict[str, tuple[Light, Light]] = {
    "even, even": (EVEN, EVEN),
    "2 : 1, even": (Light(2.0, 0.6), EVEN),
    "3 : 1, even": (Light(3.0, 0.6), EVEN),
    "4 : 1, even": (Light(4.0, 0.6), EVEN),
    "3 : 1, 3 : 1": (Light(3.0, 0.6), Light(3.0, 0.6)),
    "all half as bright, even": (Light(exposure=110.0), EVEN),
    "lamp over a corner + 100 %, even": (Light(lamp=1.0), EVEN),
}


def middle(part: PlacedPart) -> Array:
    """Returns the middle of a part's box over the tray, shape (2,) [m]."""
    points = part.points[:, :2]
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2.0)


def judged(
    finding: TrayFinding, parts: Sequence[PlacedPart]
) -> tuple[Counter[str], list[float], list[float]]:
    """Compares a finding with the truth; returns counts and errors of places [mm]."""
    counts: Counter[str] = Counter(parts=len(parts))
    places, centres = [], []
    left = list(parts)
    for each in finding.sightings:
        near = [part for part in left if np.linalg.norm(middle(part) - each.place) < _NEAR_M]
        if not near:
            counts["nothing there"] += 1
            continue
        part = min(near, key=lambda part: float(np.linalg.norm(middle(part) - each.place)))
        left.remove(part)
        if not each.names:
            counts["no class"] += 1
        else:
            counts["right" if part.name in each.names else "wrong"] += 1
            if each.names == (part.name,):
                places.append(1e3 * float(np.linalg.norm(middle(part) - each.place)))
                centres.append(1e3 * float(np.linalg.norm(middle(part) - each.blob.centre)))
    counts["no class"] += len(left)
    return counts, places, centres


def row(
    name: str, compensate: bool, layouts: int, taker: Photographer, classifier: Classifier
) -> str:
    """Returns a line of the table."""
    lit, empty = CASES[name]
    counts: Counter[str] = Counter()
    places: list[float] = []
    centres: list[float] = []
    spent = 0.0
    background = taker.photo((), empty, seed=10_000)
    for seed in range(layouts):
        parts = layout(seed)
        photo = taker.photo(parts, lit, seed)
        begin = time.process_time()
        try:
            found = blobs(photo, background, classifier.view, BlobSettings(compensate))
        except ImageInvalidError:
            counts["refused"] += 1
            continue
        counted, near, own = judged(classifier.find(found), parts)
        spent += time.process_time() - begin
        counts += counted
        places += near
        centres += own
    shares = [counts[key] for key in ("parts", "right", "wrong", "no class", "nothing there")]
    errors = [float(np.mean(each)) if each else float("nan") for each in (places, centres)]
    return (
        f"{name:34} {'with' if compensate else 'without':8}"
        + "".join(f"{share:9}" for share in shares)
        + f"{counts['refused']:9}{errors[0]:9.1f}{max(places, default=np.nan):9.1f}{errors[1]:9.1f}"
        + f"{spent / max(layouts - counts['refused'], 1):8.2f}"
    )


def draw(file: Path, taker: Photographer, classifier: Classifier) -> None:
    """Writes the flat image of a layout under uneven light, with rectangles and classes."""
    photo = taker.photo(layout(3), Light(2.0, 0.6), 3)
    finding = classifier.find(blobs(photo, taker.photo((), seed=10_000), classifier.view))
    canvas = cv2.cvtColor(classifier.view.flat(photo, "image"), cv2.COLOR_GRAY2BGR)
    canvas = np.clip(canvas.astype(float) * 1.5, 0, 255).astype(np.uint8)
    for each in finding.sightings:
        _mark(canvas, each.label, each.blob.corners, each.place, classifier.view)
    # y of the tray grows upward.
    cv2.imwrite(
        str(file),
        cv2.resize(
            _upright(canvas, finding, classifier.view),
            None,
            fx=0.65,
            fy=0.65,
            interpolation=cv2.INTER_AREA,
        ),
    )


def _mark(canvas: Image, label: str, corners: Array, place: Array, view: TrayView) -> None:
    rectangle = np.round(view.pixels(corners)).astype(np.int32)
    cv2.polylines(canvas, [rectangle], True, (80, 200, 255), 2, cv2.LINE_AA)
    dot = np.round(view.pixels(place)).astype(int)
    cv2.drawMarker(canvas, (int(dot[0]), int(dot[1])), (60, 255, 60), cv2.MARKER_CROSS, 22, 2)


def _upright(canvas: Image, finding: TrayFinding, view: TrayView) -> Image:
    """Turns the image so that y grows upward, and writes the classes above the rectangles."""
    turned = np.ascontiguousarray(canvas[::-1])
    height, width = turned.shape[:2]
    for each in finding.sightings:
        top = view.pixels(each.blob.corners)
        x, y = int(top[:, 0].mean()), int(height - 1 - top[:, 1].max()) - 12
        text = f"{each.label}, {1e4 * each.blob.area_m2:.0f} cm2, {each.blob.aspect:.2f}"
        wide = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.58, 2)[0][0]
        place = (int(np.clip(x - wide // 2, 4, width - wide - 4)), max(y, 24))
        cv2.putText(
            turned, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.58, (255, 255, 255), 2, cv2.LINE_AA
        )
    return turned


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--layouts", type=int, default=10)
    parser.add_argument("--picture", type=Path, help="write a picture of one layout")
    options = parser.parse_args()
    camera, T_tray_camera = camera_above()
    taker = Photographer(camera, T_tray_camera)
    view = TrayView(camera, taker.T_camera_tray, TRAY_SIZE_M)
    classifier = Classifier(view, {name: part_mesh(name) for name in MAKERS})
    if options.picture is not None:
        draw(options.picture, taker, classifier)
    heads = (
        "parts",
        "right",
        "wrong",
        "no class",
        "nothing",
        "refused",
        "place",
        "largest",
        "centre",
    )
    print(
        f"{'light of photo, background':34} {'':8}"
        + "".join(f"{head:>9}" for head in heads)
        + "   CPU s"
    )
    for name in CASES:
        for compensate in (False, True):
            print(row(name, compensate, options.layouts, taker, classifier), flush=True)


if __name__ == "__main__":
    main()
