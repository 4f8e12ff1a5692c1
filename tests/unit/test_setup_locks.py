"""The locks: complete, by hash, and without the address of any index."""

import re
from pathlib import Path

import pytest

from bootstrap.setup import packages_not_locked

FOLDER = Path(__file__).resolve().parents[2] / "requirements"
LOCKS = ("lock-build.txt", "lock-extras.txt", "lock-system-ros.txt", "lock-wheels.txt")
ENTRY = re.compile(r"^(?P<name>[a-z0-9-]+)==(?P<version>\S+)( ; (?P<marker>[^\\]+))? \\$")


def read_lock(name: str) -> dict[str, str]:
    """Versions by package; fails on any line that is neither entry, hash nor comment."""
    versions, hashes = {}, {}
    for line in (FOLDER / name).read_text().splitlines():
        if entry := ENTRY.match(line):
            assert entry["name"] not in versions, "one version for all Pythons"
            versions[entry["name"]] = entry["version"]
        elif re.fullmatch(r"    --hash=sha256:[0-9a-f]{64}( \\)?", line):
            last = next(reversed(versions))
            hashes[last] = hashes.get(last, 0) + 1
        else:
            assert line.startswith("#"), line
    assert versions.keys() == hashes.keys()
    return versions


def read_names(name: str) -> list[str]:
    lines = (FOLDER / name).read_text().splitlines()
    words = (line.partition("#")[0].partition("[")[0].strip() for line in lines)
    return [word.lower() for word in words if word]


@pytest.mark.parametrize("name", LOCKS)
def test_lock_has_versions_and_hashes_only(name):
    assert read_lock(name)
    text = (FOLDER / name).read_text()
    assert "://" not in text
    assert not re.search(r"index|find-links", re.sub(r"ros-ament-index-\w+", "", text))


def test_requirements_are_in_the_lock():
    wanted = [n for kind in ("", "-ros", "-dev") for n in read_names(f"requirements{kind}.in")]
    assert set(wanted) <= read_lock("lock-wheels.txt").keys()
    assert set(read_names("requirements-build.in")) <= read_lock("lock-build.txt").keys()


def test_extras_are_locked_at_the_versions_of_the_rest():
    extras, wheels = read_lock("lock-extras.txt"), read_lock("lock-wheels.txt")
    assert set(read_names("requirements-extras.in")) <= extras.keys()
    assert all(wheels[name] == extras[name] for name in extras.keys() & wheels.keys())


def test_full_installation_gets_the_same_versions_and_no_ros():
    wheels, system = read_lock("lock-wheels.txt"), read_lock("lock-system-ros.txt")
    assert system.items() <= wheels.items()
    assert set(read_names("requirements.in")) <= system.keys()
    # EmPy, colcon and NumPy's headers of the wheels would break the installation's own build tools.
    assert not [n for n in system if n.startswith(("ros-", "colcon")) or n == "empy"]


def test_no_deep_learning_framework_comes_along():
    assert not {"torch", "tensorflow", "jax"} & read_lock("lock-wheels.txt").keys()


def test_package_that_left_the_lock_is_found(tmp_path):
    for name in ("numpy-2.0.dist-info", "Old_Package-1.0.dist-info", "pip-23.dist-info"):
        (tmp_path / name).mkdir()
    lock = tmp_path / "lock.txt"
    lock.write_text("numpy==2.0 \\\n    --hash=sha256:00\n")
    assert packages_not_locked(tmp_path, [lock]) == ["old-package"]
