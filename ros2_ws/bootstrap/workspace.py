"""Builds the interface packages of the workspace with colcon, into the virtual environment.

The virtual environment is the prefix (``--merge-install --install-base .venv``) because its ``lib``
is on the library path and its ``site-packages`` on the module path of every process anyway: the
type support is found without sourcing anything.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from bootstrap.paths import Paths
from bootstrap.process import SetupError
from bootstrap.ros import has_package

#: Packages that take the place of others of the same name where those are not installed.
STAND_INS = ("control_msgs", "nav2_msgs", "tf2_msgs")

#: Every package of the workspace and the type that ``colcon list`` must give it. A package.xml that
#: is not valid makes colcon take the folder for a plain package without an error.
PACKAGE_TYPES = {
    "skinplan_msgs": "ros.ament_cmake",
    "skinplan_nodes": "ros.ament_python",
    **dict.fromkeys(STAND_INS, "ros.ament_cmake"),
}

#: Words in the stand-ins' package.xml that tell them from the originals once they are installed.
STAND_IN_MARK = "Stand-in with the types that skinplan uses"

#: Leaves out what rclpy never loads. For the wheels only: their one middleware is rmw_fastrtps_cpp.
#: Beside a full installation another may be chosen, and nodes in C++ may use the interfaces.
PYTHON_ONLY = Path(__file__).parent / "python_only.cmake"

#: Generated code only copies fields: optimising it fully would take a quarter more of the longest
#: step of the set-up.
CMAKE_SETTINGS = (
    "-DCMAKE_BUILD_TYPE=Release",
    "-DCMAKE_C_FLAGS_RELEASE=-O1 -DNDEBUG",
    "-DCMAKE_CXX_FLAGS_RELEASE=-O1 -DNDEBUG",
    "-DBUILD_TESTING=OFF",
)


def stand_ins_to_build(prefixes: Iterable[Path]) -> list[str]:
    """Choose the stand-ins whose originals are not installed.

    Args:
        prefixes: All prefixes that packages are looked for in. A stand-in of an earlier set-up
            is no original.

    Returns:
        Names of packages.
    """
    found = list(prefixes)
    return [name for name in STAND_INS if not any(_has_original(prefix, name) for prefix in found)]


def _has_original(prefix: Path, package: str) -> bool:
    if not has_package(prefix, package):
        return False
    manifest = prefix / "share" / package / "package.xml"
    try:
        return STAND_IN_MARK not in manifest.read_text(encoding="utf-8")
    except OSError:
        return True


def check_package_types(listing: str, wanted: Iterable[str]) -> None:
    """Check what ``colcon list`` says.

    Args:
        listing: Its output: name, path and type of one package per line, separated by tabs.
        wanted: Names of the packages that must be there.

    Raises:
        SetupError: A package is missing or was taken for something else.
    """
    found = {}
    for line in listing.splitlines():
        words = line.split("\t")
        if len(words) == 3:
            found[words[0]] = words[2].strip("()")
    for name in wanted:
        if found.get(name) != PACKAGE_TYPES[name]:
            raise SetupError(
                f"colcon takes {name} for {found.get(name, 'no package at all')} instead of "
                f"{PACKAGE_TYPES[name]}: its package.xml is not valid (an e-mail address without "
                "a domain is enough)"
            )


def build_interfaces(
    paths: Paths,
    stand_ins: Sequence[str],
    run: Callable[[Sequence[str | Path], str], str],
    *,
    python_only: bool,
) -> None:
    """Build and install ``skinplan_msgs`` and the stand-ins.

    Args:
        paths: Where everything is; the virtual environment is also the prefix to install into.
        stand_ins: Stand-ins to build.
        python_only: Build only what rclpy with rmw_fastrtps_cpp loads.
        run: Runs a tool; takes the command and what it is for.

    Raises:
        SetupError: A package is not valid or does not build.
    """
    folder = paths.workspace
    # The wheels bring colcon; beside a full installation it is a package of its own.
    package = "python3-colcon-common-extensions"
    run([paths.python, "-c", "import colcon_core"], f"looking for colcon (package {package})")
    colcon = [paths.python, "-m", "colcon", "--log-base", folder / "log"]
    bases = ["--base-paths", folder / "src", *(folder / "stand_ins" / name for name in stand_ins)]
    listing = run([*colcon, "list", *bases], "colcon list")
    check_package_types(listing, ["skinplan_msgs", "skinplan_nodes", *stand_ins])
    command = [*colcon, "build", *bases, "--packages-select", "skinplan_msgs", *stand_ins]
    command += ["--build-base", folder / "build", "--install-base", paths.venv, "--merge-install"]
    command += ["--event-handlers", "console_cohesion+", "--cmake-args", *CMAKE_SETTINGS]
    if python_only:
        command.append(f"-DCMAKE_PROJECT_INCLUDE={PYTHON_ONLY}")
    # CMake's own search could find another Python.
    command += [f"-D{name}_EXECUTABLE={paths.python}" for name in ("Python3", "PYTHON")]
    run(command, "building the interface packages")
