"""Stand-ins, package types, repair of the wheels, missing tools, the start-up hook."""

from pathlib import Path

import pytest

from bootstrap import environment_hook, toolchain, wheels, workspace
from bootstrap.process import SetupError
from bootstrap.ros import WHEELS_GUARD

ROOT = Path(__file__).resolve().parents[2]


def install(prefix: Path, package: str, description: str) -> None:
    marker = prefix / "share/ament_index/resource_index/packages" / package
    manifest = prefix / "share" / package / "package.xml"
    for file in (marker, manifest):
        file.parent.mkdir(parents=True, exist_ok=True)
    marker.touch()
    manifest.write_text(f"<package><description>{description}</description></package>")


def test_all_stand_ins_are_built_where_no_original_is_installed(tmp_path):
    assert workspace.stand_ins_to_build([tmp_path]) == list(workspace.STAND_INS)


def test_installed_original_is_not_stood_in_for(tmp_path):
    install(tmp_path / "ros", "nav2_msgs", "Messages and actions of the navigation stack")
    chosen = workspace.stand_ins_to_build([tmp_path / "venv", tmp_path / "ros"])
    assert chosen == ["control_msgs", "tf2_msgs"]


def test_own_stand_in_of_an_earlier_set_up_is_no_original(tmp_path):
    manifest = (ROOT / "ros2_ws/stand_ins/tf2_msgs/package.xml").read_text()
    install(tmp_path, "tf2_msgs", manifest)
    assert "tf2_msgs" in workspace.stand_ins_to_build([tmp_path])


@pytest.mark.parametrize("name", workspace.STAND_INS)
def test_stand_in_can_be_told_from_its_original(name):
    folder = ROOT / "ros2_ws/stand_ins" / name
    assert workspace.STAND_IN_MARK in (folder / "package.xml").read_text()
    assert list(folder.glob("*/*.msg")) + list(folder.glob("*/*.action"))


def test_plain_colcon_build_does_not_build_stand_ins():
    assert (ROOT / "ros2_ws/stand_ins/COLCON_IGNORE").is_file()


@pytest.mark.parametrize("name", ["skinplan_msgs", "skinplan_nodes"])
def test_workspace_links_to_the_packages(name):
    link = ROOT / "ros2_ws/src" / name
    assert link.is_symlink()
    assert link.resolve() == ROOT / name


LISTING = "skinplan_msgs\tsrc/skinplan_msgs\t(ros.ament_cmake)\n"


def test_valid_package_is_accepted():
    workspace.check_package_types(LISTING, ["skinplan_msgs"])


def test_package_with_invalid_manifest_is_refused():
    listing = LISTING.replace("ros.ament_cmake", "cmake")
    with pytest.raises(
        SetupError, match="takes skinplan_msgs for cmake instead of ros.ament_cmake"
    ):
        workspace.check_package_types(listing, ["skinplan_msgs"])


def test_missing_package_is_refused():
    with pytest.raises(SetupError, match="takes tf2_msgs for no package at all"):
        workspace.check_package_types(LISTING, ["skinplan_msgs", "tf2_msgs"])


CMAKE = (
    "/opt/python/cp311-cp311/include/python3.11;"
    "/opt/python/cp311-cp311/lib/python3.11/site-packages/numpy/_core/include;/usr/include"
)


def test_folders_of_the_build_machine_are_replaced(tmp_path):
    file = tmp_path / "std_msgs/cmake/std_msgs.cmake"
    file.parent.mkdir(parents=True)
    file.write_text(CMAKE)
    python, numpy = Path("/here/python"), Path("/here/numpy")
    assert wheels.repair_cmake_files(tmp_path, python, numpy) == 1
    assert file.read_text() == "/here/python;/here/numpy;/usr/include"
    assert wheels.repair_cmake_files(tmp_path, python, numpy) == 0


def test_replacement_is_taken_literally():
    odd = Path(r"/a\1b/\g<0>")
    assert wheels.repair_text(CMAKE, odd, odd).startswith(str(odd))


def test_other_text_is_left_alone():
    text = "/opt/python/include /usr/lib/python3/dist-packages/numpy/core/include"
    assert wheels.repair_text(text, Path("/a"), Path("/b")) == text


def test_missing_tools_are_named_with_their_packages(tmp_path):
    (tmp_path / "Python.h").touch()
    missing = toolchain.missing_tools(str(tmp_path), tmp_path, modules=())
    assert missing == {f"the program {p}": p for p in ("gcc", "g++", "cmake", "make")}


def test_missing_headers_and_modules_are_named_with_their_packages(tmp_path):
    for name in toolchain.PROGRAMS:
        (tmp_path / name).touch(mode=0o755)
    missing = toolchain.missing_tools(str(tmp_path), tmp_path, modules=("no_such_module",))
    header, module = missing
    assert "Python.h" in header and missing[header].endswith("-dev")
    assert "no_such_module" in module and missing[module].endswith("-venv")


def test_nothing_is_missing_on_a_complete_machine(tmp_path):
    for name in toolchain.PROGRAMS:
        (tmp_path / name).touch(mode=0o755)
    (tmp_path / "Python.h").touch()
    assert toolchain.missing_tools(str(tmp_path), tmp_path, modules=("json",)) == {}


def test_hook_completes_an_empty_environment():
    environ = {}
    assert not environment_hook.complete(environ, ["/v"], [], "/v/lib")
    assert environ == {"AMENT_PREFIX_PATH": "/v"}


def test_hook_changes_nothing_the_second_time():
    environ = {"AMENT_PREFIX_PATH": "/other"}
    assert environment_hook.complete(environ, ["/v", "/ros"], ["/v/lib", "/ros/lib"], "/v/lib")
    first = dict(environ)
    assert not environment_hook.complete(environ, ["/v", "/ros"], ["/v/lib", "/ros/lib"], "/v/lib")
    assert environ == first
    assert environ["AMENT_PREFIX_PATH"] == "/v:/ros:/other"
    assert environ["LD_LIBRARY_PATH"] == "/v/lib:/ros/lib"


def test_hook_throws_out_what_another_virtual_environment_left(tmp_path):
    (tmp_path / "pyvenv.cfg").touch()
    environ = {WHEELS_GUARD: "1", "LD_LIBRARY_PATH": f"{tmp_path}/lib:/opt/cuda/lib"}
    assert not environment_hook.complete(environ, ["/v"], [], "/v/lib")
    assert WHEELS_GUARD not in environ
    assert environ["LD_LIBRARY_PATH"] == "/opt/cuda/lib"


def test_hook_keeps_the_guard_of_its_own_environment(tmp_path):
    own = f"{tmp_path}/lib"
    environ = {WHEELS_GUARD: "1", "LD_LIBRARY_PATH": own}
    assert not environment_hook.complete(environ, [str(tmp_path)], [], own)
    assert environ[WHEELS_GUARD] == "1"
    assert environ["LD_LIBRARY_PATH"] == own
