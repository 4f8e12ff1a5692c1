"""Every field of the interfaces is commented, the index is complete, results end with a status."""

import re
from pathlib import Path

import pytest
from skinplan_msgs.msg import Status

FOLDER = Path(__file__).resolve().parents[2] / "skinplan_msgs"
FILES = sorted(f for kind in ("msg", "srv", "action") for f in FOLDER.glob(f"{kind}/*.{kind}"))
FIELD = re.compile(
    r"^(?P<type>[A-Za-z][\w/<>=]*(\[[<=\d]*\])?)\s+(?P<name>[a-z]\w*)\s*(?P<rest>.*)$"
)
#: A unit in brackets, "1" for what has none.
UNIT = re.compile(r"\[(1|[a-z^0-9/%*]+)\]")


def fields_without_comment(text: str) -> list[str]:
    """Names of fields that have neither a comment behind them nor one in the line before."""
    names, before = [], ""
    for line in text.splitlines():
        match = FIELD.match(line.strip())
        if match and "=" not in match["rest"].partition("#")[0]:
            own = match["rest"].partition("#")[2].strip()
            if not own and not before.strip().startswith("#") and match["type"] != "Status":
                names.append(match["name"])
        before = line
    return names


def sections(text: str) -> list[list[str]]:
    """Fields of each section of an interface, each as "type name"."""
    result = []
    for section in re.split(r"^---$", text, flags=re.MULTILINE):
        matches = (FIELD.match(line.strip()) for line in section.splitlines())
        found = [
            f"{m['type']} {m['name']}"
            for m in matches
            if m and "=" not in m["rest"].partition("#")[0]
        ]
        result.append(found)
    return result


def test_there_are_interfaces():
    assert len(FILES) > 30


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.name)
def test_every_field_is_commented(file):
    text = file.read_text()
    assert text.startswith("#"), "the file must say first what it is"
    assert fields_without_comment(text) == []


def test_a_bare_field_is_found():
    assert fields_without_comment("# What\n\nfloat64 a\n# of b\nfloat64 b\nint32 C = 1\n") == ["a"]


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.name)
def test_floats_have_a_unit(file):
    lines = [line for line in file.read_text().splitlines() if line.startswith("float")]
    assert [line for line in lines if not UNIT.search(line)] == []


@pytest.mark.parametrize("file", [f for f in FILES if f.suffix != ".msg"], ids=lambda f: f.name)
def test_answers_end_with_a_status(file):
    assert sections(file.read_text())[1][-1] == "Status status"


def test_index_lists_every_interface_and_nothing_else():
    rows = re.findall(
        r"^\| \[`(\w+)`\]\((\S+)\) \| (.+) \|$", (FOLDER / "README.md").read_text(), re.MULTILINE
    )
    assert sorted(path for _, path, _ in rows) == sorted(str(f.relative_to(FOLDER)) for f in FILES)
    assert all(name == Path(path).stem and len(text) > 10 for name, path, text in rows)


def test_nobody_answered_is_not_ok():
    assert (Status.UNSET, Status.OK) == (0, 1)
    assert Status().code == Status.UNSET


def test_status_codes_are_unique():
    codes = re.findall(
        r"^uint16 [A-Z_]+ = (\d+)$", (FOLDER / "msg/Status.msg").read_text(), re.MULTILINE
    )
    assert len(codes) == len(set(codes)) > 40
