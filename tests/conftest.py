"""Of all test rooms: an own ROS domain per test process, the shared data, the run without ROS."""

import os
import sys
from importlib.abc import MetaPathFinder
from pathlib import Path

import pytest

from ros_domains import own_domain

ROOT = Path(__file__).resolve().parents[1]

#: Top-level packages that count as ROS besides all ``*_msgs``.
ROS_PACKAGES = (
    "rclpy",
    "rcl_interfaces",
    "builtin_interfaces",
    "ament_index_python",
    "std_srvs",
    "skinplan_nodes",
)


# Overrides what the shell says: a developer's domain may have a real robot in it.
_DOMAIN = own_domain()
_DOMAIN.__enter__()
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
for _name in ("ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "ROS_DISCOVERY_SERVER", "ROS_NAMESPACE"):
    os.environ.pop(_name, None)


class _RosIsNotHere(MetaPathFinder):
    """Makes ROS look as if it were not installed."""

    def find_spec(self, fullname, path=None, target=None):
        top = fullname.partition(".")[0]
        if top in ROS_PACKAGES or top.endswith("_msgs"):
            raise ModuleNotFoundError(
                f"No module named {fullname!r} (run without ROS)", name=fullname
            )
        return None


def pytest_addoption(parser):
    parser.addoption(
        "--without-ros", action="store_true", help="as if no part of ROS were installed"
    )


def pytest_configure(config):
    if config.getoption("--without-ros"):
        loaded = sorted(
            name for name in sys.modules if name in ROS_PACKAGES or name.endswith("_msgs")
        )
        if loaded:
            raise pytest.UsageError(
                f"--without-ros comes too late, already imported: {', '.join(loaded)}"
            )
        sys.meta_path.insert(0, _RosIsNotHere())


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the data that is handed out beside the repository (models, images, recordings)."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"needs the data folder {folder}, which is not there")
    return folder
