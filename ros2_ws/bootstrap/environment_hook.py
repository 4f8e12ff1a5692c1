"""Start-up hook of the virtual environment: completes the ROS environment, nothing needs sourcing.

Copied by the set-up into ``site-packages``, where a ``.pth`` file imports it before anything else;
the paths stand in the JSON file beside it. It runs at every start of Python, hence the few imports.
"""

import json
import os
import sys

#: Set by the wheels' own start-up hook once it has put their libraries on ``LD_LIBRARY_PATH``.
_WHEELS_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


def complete(environ, prefixes, library_paths, own_library_path):
    """Add what is missing to the environment.

    Args:
        environ: The environment, changed in place.
        prefixes: Folders that must be on ``AMENT_PREFIX_PATH``, in this order.
        library_paths: Folders that must be on ``LD_LIBRARY_PATH``.
        own_library_path: The virtual environment's ``lib``. When the wheels' guard is there and
            this folder is not, the guard was inherited from another virtual environment: it is
            taken away together with that one's libraries.

    Returns:
        Whether Python has to be started anew for the libraries to be found (the loader reads the
        path at start only).
    """
    ament = [path for path in environ.get("AMENT_PREFIX_PATH", "").split(":") if path]
    environ["AMENT_PREFIX_PATH"] = ":".join(
        [path for path in prefixes if path not in ament] + ament
    )
    libraries = [path for path in environ.get("LD_LIBRARY_PATH", "").split(":") if path]
    if environ.get(_WHEELS_GUARD) and own_library_path not in libraries:
        del environ[_WHEELS_GUARD]
        libraries = [path for path in libraries if not _is_in_virtual_environment(path)]
        environ["LD_LIBRARY_PATH"] = ":".join(libraries)
    missing = [path for path in library_paths if path not in libraries]
    if missing:
        environ["LD_LIBRARY_PATH"] = ":".join(missing + libraries)
    return bool(missing)


def _is_in_virtual_environment(path):
    parts = path.split("/")
    return any(
        os.path.exists("/".join([*parts[:n], "pyvenv.cfg"])) for n in range(len(parts), 1, -1)
    )


def run():
    """Read the paths and complete this process's environment."""
    with open(
        os.path.join(os.path.dirname(__file__), "_skinplan_environment.json"), encoding="utf-8"
    ) as file:
        paths = json.load(file)
    own = os.path.join(sys.prefix, "lib")
    if complete(os.environ, paths["prefixes"], paths["library_paths"], own):
        os.execve(sys.executable, sys.orig_argv, os.environ)
    sys.path.extend(path for path in paths["python_paths"] if path not in sys.path)


if __name__ != "__main__" and os.path.exists(
    os.path.join(os.path.dirname(__file__), "_skinplan_environment.json")
):
    run()
