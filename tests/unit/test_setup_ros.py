"""Where ROS 2 is taken from."""

import json
import sys

import pytest

from bootstrap.process import SetupError
from bootstrap.ros import Ros, check_ros_python, find_ros, has_package, remembered_ros

OWN_PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"


@pytest.fixture
def jazzy(tmp_path):
    """A prefix that looks like a full installation with rclpy for this Python."""
    prefix = tmp_path / "opt/ros/jazzy"
    add_package(prefix, "rclpy")
    (prefix / f"lib/{OWN_PYTHON}/site-packages/rclpy").mkdir(parents=True)
    return prefix


def add_package(prefix, name):
    folder = prefix / "share/ament_index/resource_index/packages"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).touch()


def sourced(prefix, **more):
    modules = prefix / f"lib/{OWN_PYTHON}/site-packages"
    return {
        "AMENT_PREFIX_PATH": str(prefix),
        "LD_LIBRARY_PATH": f"{prefix}/lib",
        "PYTHONPATH": f"{modules}:/home/someone/modules",
        "ROS_DISTRO": "jazzy",
        **more,
    }


def test_wheels_where_nothing_is_sourced(tmp_path):
    assert find_ros({}, tmp_path / ".venv") == Ros()
    assert not find_ros({"AMENT_PREFIX_PATH": ""}, tmp_path / ".venv").is_system


def test_sourced_installation_is_used(tmp_path, jazzy):
    ros = find_ros(sourced(jazzy), tmp_path / ".venv")
    assert ros.is_system
    assert ros.prefixes == (jazzy,)
    assert ros.library_paths == (jazzy / "lib",)
    # Somebody's own modules are not part of the installation.
    assert ros.python_paths == (jazzy / f"lib/{OWN_PYTHON}/site-packages",)


def test_overlays_are_kept_in_their_order(tmp_path, jazzy):
    overlay = tmp_path / "overlay"
    add_package(overlay, "control_msgs")
    environ = sourced(jazzy, AMENT_PREFIX_PATH=f"{overlay}:{jazzy}")
    assert find_ros(environ, tmp_path / ".venv").prefixes == (overlay, jazzy)


def test_wheels_where_the_sourced_prefix_has_no_rclpy(tmp_path):
    add_package(tmp_path / "other", "geometry_msgs")
    assert not find_ros(sourced(tmp_path / "other"), tmp_path / ".venv").is_system


def test_own_environment_is_no_installation(tmp_path):
    venv = tmp_path / ".venv"
    add_package(venv, "rclpy")
    assert not find_ros(sourced(venv), venv).is_system


def test_another_virtual_environment_is_no_installation(tmp_path):
    other = tmp_path / "elsewhere"
    add_package(other, "rclpy")
    (other / "pyvenv.cfg").touch()
    assert not find_ros(sourced(other), tmp_path / ".venv").is_system


def test_another_release_is_refused_by_name(tmp_path, jazzy):
    with pytest.raises(SetupError, match="sourced ROS 2 is humble and skinplan needs jazzy"):
        find_ros(sourced(jazzy, ROS_DISTRO="humble"), tmp_path / ".venv")


def write_settings(tmp_path, **paths):
    file = tmp_path / "settings.json"
    file.write_text(json.dumps({"library_paths": [], "python_paths": [], **paths}))
    return file


def test_installation_is_remembered_where_nothing_is_sourced(tmp_path, jazzy):
    venv = tmp_path / ".venv"
    prefixes = [str(venv), str(jazzy)]
    libraries = [str(venv / "lib"), str(jazzy / "lib")]
    settings = write_settings(tmp_path, prefixes=prefixes, library_paths=libraries)
    assert remembered_ros(settings, venv) == Ros((jazzy,), (jazzy / "lib",), ())


def test_installation_that_is_gone_is_forgotten(tmp_path):
    settings = write_settings(tmp_path, prefixes=[str(tmp_path / "gone")])
    assert remembered_ros(settings, tmp_path / ".venv") == Ros()


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"prefixes": 1}'])
def test_unreadable_memory_means_the_wheels(tmp_path, content):
    (tmp_path / "settings.json").write_text(content)
    assert remembered_ros(tmp_path / "settings.json", tmp_path / ".venv") == Ros()
    assert remembered_ros(tmp_path / "none.json", tmp_path / ".venv") == Ros()


def test_python_of_the_installation_is_accepted(tmp_path, jazzy):
    check_ros_python(find_ros(sourced(jazzy), tmp_path / ".venv"))


def test_rclpy_for_another_python_is_refused(tmp_path):
    prefix = tmp_path / "ros"
    add_package(prefix, "rclpy")
    (prefix / "lib/python3.9/site-packages/rclpy").mkdir(parents=True)
    with pytest.raises(SetupError, match=r"is for python3\.9 .* PYTHON=/usr/bin/python3\.9"):
        check_ros_python(find_ros(sourced(prefix), tmp_path / ".venv"))


def test_package_is_found_by_its_marker(jazzy):
    assert has_package(jazzy, "rclpy")
    assert not has_package(jazzy, "rclcpp")
