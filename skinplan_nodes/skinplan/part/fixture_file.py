"""Fixture files: which markers are where on what holds the part, or that it has none."""

from pathlib import Path

import yaml

from skinplan.errors import PartInvalidError, PartNotFoundError
from skinplan.part.fields import Fields, pose_fields
from skinplan.part.model import Fixture, Marker
from skinplan.transforms import transform

MARKER_COUNTS = {
    **{
        f"DICT_{size}X{size}_{count}": count
        for size in (4, 5, 6, 7)
        for count in (50, 100, 250, 1000)
    },
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
    "DICT_ARUCO_MIP_36h12": 250,
}
_KEYS = ("dictionary", "pose_in_workpiece", "markers")
#: Stands for the list of markers where there are none.
NO_MARKERS = "none"
_LARGEST_FILE_BYTES = 1_000_000


def read_fixture(fields: Fields, folder: Path) -> Fixture:
    """Reads the key ``fixture`` of a part file: a mapping, or the name of a fixture file.

    Args:
        fields: The part file.
        folder: Its folder, which the name of a fixture file is relative to.

    Raises:
        PartNotFoundError: No such fixture file.
        PartInvalidError: A key is unknown or missing, or a value is out of range.
    """
    values = fields.values["fixture"]
    if isinstance(values, str):
        return load_fixture(folder / fields.text("fixture"))
    return _fixture(Fields(values, "fixture", fields.source, _KEYS))


def load_fixture(path: Path | str) -> Fixture:
    """Reads a fixture file: ``dictionary``, ``markers`` with ``id``, ``size_m`` and pose.

    A fixture without markers says ``markers: none`` and has no dictionary.

    Raises:
        PartNotFoundError: No such file.
        PartInvalidError: A key is unknown or missing, or a value is out of range.
    """
    file = Path(path)
    return _fixture(Fields(read_yaml(file, "fixture"), "", file.name, _KEYS))


def fixture_fields(fixture: Fixture) -> dict[str, object]:
    """Returns a fixture in the form in which `read_fixture` reads it."""
    pose = pose_fields(fixture.T_workpiece_fixture)
    if not fixture.markers:
        return {"pose_in_workpiece": pose, "markers": NO_MARKERS}
    return {
        "dictionary": fixture.dictionary,
        "pose_in_workpiece": pose,
        "markers": [
            {
                "id": marker.id,
                "size_m": marker.size_m,
                "pose_in_fixture": pose_fields(marker.T_fixture_marker),
            }
            for marker in fixture.markers
        ],
    }


def _fixture(fixture: Fields) -> Fixture:
    pose = fixture.pose("pose_in_workpiece") if fixture.has("pose_in_workpiece") else transform()
    entries = fixture.values.get("markers")
    if entries == NO_MARKERS:
        if fixture.has("dictionary"):
            raise fixture.error(
                "dictionary",
                f"{str(fixture.values['dictionary'])[:60]!r} beside markers: {NO_MARKERS}",
                "a dictionary with a list of markers, or neither of them",
            )
        return Fixture("", pose, ())
    dictionary = fixture.text("dictionary", "the name of an ArUco dictionary")
    if dictionary not in MARKER_COUNTS:
        raise fixture.error("dictionary", repr(dictionary), f"one of {', '.join(MARKER_COUNTS)}")
    if not isinstance(entries, list) or not entries:
        found = "nothing" if not entries else repr(entries)[:60]
        raise fixture.error(
            "markers",
            found,
            f"a list of at least one marker, or the word {NO_MARKERS} where there are none and "
            "the part is located by its shape",
        )
    markers = tuple(
        _read_marker(
            entry, fixture.path(f"markers[{number}]"), fixture.source, MARKER_COUNTS[dictionary]
        )
        for number, entry in enumerate(entries)
    )
    ids = [marker.id for marker in markers]
    if len(set(ids)) < len(ids):
        raise fixture.error("markers", f"the ids {ids}", "every id once")
    return Fixture(dictionary, pose, markers)


def _read_marker(entry: object, place: str, source: str, count: int) -> Marker:
    marker = Fields(entry, place, source, ("id", "size_m", "pose_in_fixture"))
    return Marker(
        id=marker.integer("id", 0, count - 1),
        size_m=marker.number("size_m", 0.005, 2.0, "the side of the black square, 0.005 to 2 [m]"),
        T_fixture_marker=marker.pose("pose_in_fixture"),
    )


def read_yaml(file: Path, kind: str = "part") -> object:
    """Reads a YAML file of bounded size.

    Args:
        file: The file.
        kind: What it is, for messages.

    Raises:
        PartNotFoundError: No such file.
        PartInvalidError: It is too large or no YAML.
    """
    if not file.is_file():
        raise PartNotFoundError(
            f"no {kind} file at {file}; the path of an existing {kind}.yaml is accepted"
        )
    try:
        if file.stat().st_size > _LARGEST_FILE_BYTES:
            raise PartInvalidError(
                f"{file.name}: a {kind} file of {file.stat().st_size} bytes was found; up to "
                f"{_LARGEST_FILE_BYTES} "
                "are accepted (is it a mesh?)"
            )
        return yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise PartInvalidError(
            f"{file.name}: YAML text is accepted, but it can't be read: {reason}"
        ) from error
