"""The cell: what stands where, limits of its devices (`cell_model`), its file (`cell_file`)."""

from skinplan.robot.cell_file import load_cell
from skinplan.robot.cell_model import (
    CameraConfig,
    CellConfig,
    Obstacle,
    QualitySettings,
    TrackerSettings,
)

__all__ = [
    "CameraConfig",
    "CellConfig",
    "Obstacle",
    "QualitySettings",
    "TrackerSettings",
    "load_cell",
]
