"""Profiles of Fast DDS: ours unless the user has some."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from skinplan_nodes.dds_transport import use_large_shared_memory

OURS = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")


def test_the_profiles_are_there_and_well_formed() -> None:
    environment: dict[str, str] = {}
    use_large_shared_memory(environment)
    (path,) = {environment[name] for name in OURS}
    root = ET.fromstring(Path(path).read_text(encoding="utf-8"))
    (size,) = root.iter("{http://www.eprosima.com}segment_size")
    assert int(size.text or "") == 32 * 2**20


@pytest.mark.parametrize("name", OURS)
def test_profiles_of_the_user_stay(name: str) -> None:
    environment = {name: "/home/me/profiles.xml"}
    use_large_shared_memory(environment)
    assert environment == {name: "/home/me/profiles.xml"}
