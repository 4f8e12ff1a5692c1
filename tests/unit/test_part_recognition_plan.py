"""Whether a part file asks that the part is identified."""

from pathlib import Path

import pytest

from skinplan.errors import PartInvalidError
from skinplan.part.recognition_plan import RecognitionPlan, read_recognition, recognition_fields


def test_what_is_left_out_is_not_checked(tmp_path: Path) -> None:
    assert read_recognition({}, tmp_path, "part.yaml") == RecognitionPlan(False, ())


def test_paths_are_relative_to_the_part_file_and_survive(tmp_path: Path) -> None:
    found = read_recognition({"check": True, "others": ["../rib/part.yaml"]}, tmp_path, "part.yaml")
    assert found == RecognitionPlan(True, ((tmp_path.parent / "rib" / "part.yaml").resolve(),))
    assert read_recognition(recognition_fields(found), Path("/elsewhere"), "part.yaml") == found


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"check": "yes"}, "check"),
        ({"chekc": True}, "chekc"),
        ({"others": "rib.yaml"}, "a list of up to 50 paths"),
        ({"others": [7]}, "a list of up to 50 paths"),
        ({"others": [""]}, "a list of up to 50 paths"),
        ({"others": ["a.yaml", "./a.yaml"]}, "a path twice"),
        ({"others": [f"{n}.yaml" for n in range(51)]}, "a list of up to 50 paths"),
        ([], "recognition"),
    ],
)
def test_bad_values_are_named(values: object, said: str, tmp_path: Path) -> None:
    with pytest.raises(PartInvalidError, match=said):
        read_recognition(values, tmp_path, "part.yaml")
