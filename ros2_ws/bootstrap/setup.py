"""The steps of the set-up, in order."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bootstrap import wheels, workspace
from bootstrap.nodes import install_nodes
from bootstrap.paths import Paths, tool_environment
from bootstrap.process import SetupError, exclusive, run_tool, stop_orphans
from bootstrap.ros import check_ros_python, find_ros, remembered_ros
from bootstrap.state import State, hash_of
from bootstrap.toolchain import require_tools

HERE = Path(__file__).parent

#: Imported together in one process at the end: shared libraries that do not go together show here
#: and not in a run.
_IMPORTS = """
import numpy, scipy.optimize, trimesh, embreex, cv2, pinocchio, coal, eaik, toppra, mcap
import rclpy, control_msgs.action, nav2_msgs.action, tf2_msgs.msg
import skinplan_msgs.msg, skinplan_msgs.srv, skinplan_msgs.action
import importlib, pkgutil, skinplan, skinplan_nodes
for package in (skinplan, skinplan_nodes):
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        importlib.import_module(module.name)
"""


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes:
        name: Name in the state file.
        text: What is announced.
        key: Hash of what the step itself depends on.
        action: Does it; may be repeated.
    """

    name: str
    text: str
    key: str
    action: Callable[[], None]


def run_setup(root: Path) -> None:
    """Make every command and test runnable; do nothing where that is so already.

    Args:
        root: The work tree.

    Raises:
        SetupError: Something is missing or a tool failed.
    """
    paths = Paths(root)
    with exclusive(paths.workspace / ".setup.lock"):
        Setup(paths).run()


def packages_not_locked(site_packages: Path, locks: Sequence[Path]) -> list[str]:
    """List installed packages that no lock names.

    Args:
        site_packages: Folder of the installed modules.
        locks: The locks.

    Returns:
        Normalised names; pip itself and our own package are never among them.
    """
    lines = (line for lock in locks for line in lock.read_text(encoding="utf-8").splitlines())
    locked = {line.partition("==")[0] for line in lines if "==" in line and line[0].isalnum()}
    folders = site_packages.glob("*.dist-info")  # <name>-<version>.dist-info
    names = {re.sub(r"[-_.]+", "-", folder.name.partition("-")[0]).lower() for folder in folders}
    return sorted(names - locked - {"pip", "skinplan-nodes"})


class Setup:
    """One run of the set-up, with the lock held."""

    def __init__(self, paths: Paths) -> None:
        """Look at what is there.

        Args:
            paths: Where everything is.

        Raises:
            SetupError: The sourced ROS 2 cannot be used.
        """
        self._paths = paths
        self._ros = find_ros(os.environ, paths.venv)
        if not self._ros.is_system:
            self._ros = remembered_ros(paths.hook_settings, paths.venv)
        if self._ros.is_system:
            check_ros_python(self._ros)
        lock = "lock-system-ros.txt" if self._ros.is_system else "lock-wheels.txt"
        self._locks = [paths.root / "requirements" / name for name in ("lock-build.txt", lock)]
        self._state = State(paths.state)
        self._prepared = False

    def run(self) -> None:
        """Run the steps whose key has changed, and all that come after a changed one."""
        # Cut off in the middle of installing, pip leaves packages that it can neither use nor
        # remove: start from nothing then.
        broken = self._state.is_broken("packages") or not self._paths.python.exists()
        key = ""
        for step in self._steps():
            key = hash_of(key, step.key)
            if not self._state.is_done(step.name, key) or (broken and step.name == "environment"):
                self._run_step(step, key)
        if self._prepared:
            print(f"setup: ready, in {self._paths.venv}", flush=True)

    def _steps(self) -> Iterator[Step]:
        root, locks = self._paths.root, self._locks
        prefixes = "|".join(map(str, self._ros.prefixes))
        executable = os.path.realpath(sys.executable)
        own_hash = hash_of(sys.version, executable, str(self._paths.venv), prefixes)
        python = f"virtual environment with Python {sys.version.split()[0]}"
        yield Step("environment", python, own_hash, self._make_environment)
        yield Step("packages", "packages (minutes)", hash_of(*locks), self._install_packages)
        own_hash = hash_of(HERE / "environment_hook.py", HERE / "wheels.py", repr(self._ros))
        yield Step("hook", "start-up hook, repair of the wheels", own_hash, self._install_hook)
        names = ("package.xml", "CMakeLists.txt", "msg", "srv", "action")
        sources = [root / "skinplan_msgs" / name for name in names]
        build = [root / "ros2_ws/stand_ins", HERE / "workspace.py", workspace.PYTHON_ONLY]
        own_hash = hash_of(*sources, *build)
        text = "interface packages (minutes)"
        yield Step("interfaces", text, own_hash, self._build_interfaces)
        package = root / "skinplan_nodes"
        sources = [package / "setup.py", package / "setup.cfg", package / "package.xml"]
        own_hash = hash_of(*sources, HERE / "nodes.py")
        yield Step("nodes", "commands and nodes", own_hash, self._install_nodes)
        yield Step("imports", "all modules in one process", _IMPORTS, self._check_imports)

    def _run_step(self, step: Step, key: str) -> None:
        if not self._prepared:
            self._prepare()
        print(f"setup: {step.text} ...", flush=True)
        start = time.monotonic()
        if step.name == "interfaces" and self._state.is_broken(step.name):
            # A compiler that was cut off may have left half an object file that looks current.
            shutil.rmtree(self._paths.workspace / "build", ignore_errors=True)
        if step.name != "environment":
            self._state.begin(step.name, key)
        step.action()
        self._state.finish(step.name, key)
        print(f"setup: {step.text}: {time.monotonic() - start:.0f} s", flush=True)

    def _prepare(self) -> None:
        require_tools()
        stop_orphans(self._paths.root)
        self._paths.log.parent.mkdir(parents=True, exist_ok=True)
        self._paths.log.write_text("", encoding="utf-8")
        self._prepared = True

    def _make_environment(self) -> None:
        venv, old = self._paths.venv, self._paths.old_venv
        if venv.exists():
            ours = (venv / "pyvenv.cfg").exists() or self._paths.state.exists()
            if not ours and any(venv.iterdir()):
                raise SetupError(f"{venv} is there and is no virtual environment: move it away")
            shutil.rmtree(old, ignore_errors=True)
            venv.rename(old)
        shutil.rmtree(old, ignore_errors=True)
        shutil.rmtree(self._paths.workspace / "build", ignore_errors=True)
        self._state = State(self._paths.state)
        self._state.begin("environment", "")
        options = ["--system-site-packages"] if self._ros.is_system else []
        self._tool([sys.executable, "-m", "venv", *options, venv], "making .venv")

    def _install_packages(self) -> None:
        # No build isolation: what builds a package is locked as well. No dependencies: the lock is
        # complete.
        pip = [self._paths.python, "-m", "pip", "install", "--no-input", "--progress-bar", "off"]
        pip += ["--disable-pip-version-check", "--no-deps", "--no-build-isolation"]
        # Most modules are never imported, and compiling all costs 30 s: see `_check_imports`.
        pip += ["--use-pep517", "--no-compile"]
        for lock in self._locks:
            command = [*pip, "--require-hashes", "-r", lock]
            what = f"installing {lock.relative_to(self._paths.root)}"
            # Modules of a sourced installation must not count as installed here.
            self._tool(command, what, PYTHONPATH="")
        # What is no longer in the lock would hide that something still needs it.
        known = [*self._locks, self._paths.root / "requirements" / "lock-extras.txt"]
        unlocked = packages_not_locked(self._paths.site_packages, known)
        if unlocked:
            command = [self._paths.python, "-m", "pip", "uninstall", "--yes", *unlocked]
            self._tool(command, "removing packages that are no longer in the lock")

    def _install_hook(self) -> None:
        paths, ros, folder = self._paths, self._ros, self._paths.site_packages
        # The wheels' own hook takes care of their libraries.
        libraries = (paths.venv / "lib", *ros.library_paths) if ros.is_system else ()
        settings = {
            "prefixes": [str(path) for path in (paths.venv, *ros.prefixes)],
            "library_paths": [str(path) for path in libraries],
            "python_paths": [str(path) for path in ros.python_paths],
        }
        text = json.dumps(settings, indent=1)
        paths.hook_settings.write_text(text, encoding="utf-8")
        shutil.copyfile(HERE / "environment_hook.py", folder / "_skinplan_environment.py")
        # The name sorts before the wheels' hook, which must see what this one has repaired.
        pth = folder / "_skinplan_environment.pth"
        pth.write_text("import _skinplan_environment\n", encoding="utf-8")
        if not ros.is_system:
            code = "import numpy; print(numpy.get_include())"
            numpy_include = self._tool([paths.python, "-c", code], "finding numpy's headers")
            include = Path(sysconfig.get_paths()["include"])
            share = paths.venv / "share"
            wheels.repair_cmake_files(share, include, Path(numpy_include.strip()))

    def _build_interfaces(self) -> None:
        prefixes = [self._paths.venv, *self._ros.prefixes]
        stand_ins = workspace.stand_ins_to_build(prefixes)
        python_only = not self._ros.is_system
        workspace.build_interfaces(self._paths, stand_ins, self._tool, python_only=python_only)

    def _install_nodes(self) -> None:
        install_nodes(self._paths, self._tool)

    def _check_imports(self) -> None:
        # Also where an environment says that no bytecode is to be written: otherwise every start of
        # a command or a node compiles 2000 modules, which takes 6 s.
        # -P: the folder `skinplan_nodes` here is not the package of that name.
        command = [self._paths.python, "-P", "-c", _IMPORTS]
        self._tool(command, "importing all modules in one process", PYTHONDONTWRITEBYTECODE="")

    def _tool(self, command: Sequence[str | Path], what: str, **variables: str) -> str:
        env = tool_environment(os.environ, self._paths, self._ros) | variables
        return run_tool(command, cwd=self._paths.root, env=env, log=self._paths.log, what=what)
