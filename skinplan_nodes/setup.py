"""Package of the planning library ``skinplan`` (no ROS) and of its nodes ``skinplan_nodes``."""

from glob import glob

from setuptools import find_packages, setup

NAME = "skinplan_nodes"

#: Every node is a module of this name with a function ``main``, and a command of this name.
NODES = (
    "aruco_localizer",
    "bag_player",
    "cell_supervisor",
    "mock_camera",
    "mock_ctrack",
    "mock_mir100",
    "mock_ur5",
    "part_recognizer",
    "run_recorder",
    "scan_inspector",
    "scan_path_planner",
    "sim_clock",
    "station_planner",
    "trajectory_planner",
)

#: Endings of the data files that lie beside the modules.
DATA_KINDS = ("css", "html", "j2", "json", "srdf", "stl", "urdf", "xml", "yaml")

setup(
    name=NAME,
    version="0.1.0",
    description="Measures large parts with a mobile robot and a tracked scanner.",
    maintainer="skinplan maintainers",
    maintainer_email="maintainers@skinplan.example",
    license="Apache-2.0",
    python_requires=">=3.11,<3.13",
    packages=find_packages(
        include=["skinplan", "skinplan.*", "skinplan_nodes", "skinplan_nodes.*"]
    ),
    # Everything that lies beside the modules: robot models, sample parts, templates.
    package_data={"": [f"**/*.{kind}" for kind in DATA_KINDS] + ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.yaml"))),
        (f"share/{NAME}/launch", sorted(glob("../launch_scripts/*.launch.py"))),
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "skinplan = skinplan.cli:main",
            *(f"{node} = {NAME}.{node}:main" for node in NODES),
        ]
    },
)
