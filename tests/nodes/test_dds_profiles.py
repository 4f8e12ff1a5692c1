"""Profiles of Fast DDS: ours unless the user has some."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from skinplan_nodes.dds_profiles import use_profiles

VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")


@pytest.mark.parametrize(
    ("discovery", "large", "segments"),
    [
        ("LOCALHOST", True, ["33554432"]),
        ("LOCALHOST", False, []),
        # The transports of a graph on several machines are not ours.
        ("SUBNET", True, []),
    ],
)
def test_profiles_are_well_formed(discovery: str, large: bool, segments: list[str]) -> None:
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": discovery}
    use_profiles(large, environment)
    (path,) = {environment[name] for name in VARIABLES}
    root = ET.fromstring(Path(path).read_text(encoding="utf-8"))
    space = "{http://www.eprosima.com}"
    assert [found.text for found in root.iter(f"{space}segment_size")] == segments
    assert len([*root.iter(f"{space}heartbeatPeriod")]) == 1


@pytest.mark.parametrize("name", VARIABLES)
def test_profiles_of_the_user_stay(name: str) -> None:
    environment = {name: "/home/me/profiles.xml", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    before = dict(environment)
    use_profiles(True, environment)
    assert environment == before
