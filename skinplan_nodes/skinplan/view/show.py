"""Shows a plan: pictures in a folder, and the 3-D scene in the browser."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skinplan.pipeline import Plan
from skinplan.robot.cell import CellConfig
from skinplan.view.browser import BrowserView
from skinplan.view.pictures import write_pictures
from skinplan.view.scene_data import SceneData
from skinplan.view.subject import subject_of_plan


@dataclass(frozen=True)
class Shown:
    """What is shown of a plan; a context manager, at whose end the scene is no longer served.

    Attributes:
        pictures: The files written.
        view: The scene being served; None when none was asked for.
        note: What the user should know about it: another port, a coarser mesh; empty = nothing.
    """

    pictures: tuple[Path, ...]
    view: BrowserView | None = None
    note: str = ""

    def document(self) -> dict[str, Any]:
        """Returns what ``--json`` prints as ``view``."""
        url = None if self.view is None else self.view.url
        return {"pictures": [str(file) for file in self.pictures], "url": url}

    def wait(self) -> None:
        """Serves the scene until the process is told to end; returns at once without one."""
        if self.view is not None:
            self.view.wait()

    def __enter__(self) -> "Shown":
        return self

    def __exit__(self, *_: object) -> None:
        if self.view is not None:
            self.view.stop()


def show_plan(
    plan: Plan,
    cell: CellConfig,
    folder: Path | None,
    port: int | None,
    progress: Callable[[float, str], None] | None = None,
    animate: bool = False,
) -> Shown:
    """Writes the pictures of a plan and starts to serve its scene.

    Args:
        plan: The plan.
        cell: The cell that it was made for.
        folder: Where the pictures go; None = no pictures.
        port: Where the scene is served; None = not at all.
        progress: Told the share done and what is being done.
        animate: Also write the animation of the arm.

    Returns:
        What is shown.

    Raises:
        InputError: An animation of a plan in which nothing moves.
        ViewerMissingError: viser is not installed.
        PortBusyError: No free port.
        OSError: The folder can't be written.
    """
    subject = subject_of_plan(plan, cell)
    pictures = () if folder is None else write_pictures(subject, folder, progress, animate)
    if port is None:
        return Shown(pictures)
    data = SceneData(subject)
    view = BrowserView(data, port)
    notes = []
    if port not in (0, view.port):
        notes.append(f"port {port} is busy, {view.port} is used")
    if data.is_thinned:
        shown, all_of_them = len(data.display.mesh.faces), len(subject.mesh.faces)
        notes.append(f"the browser shows {shown} triangles for the part's {all_of_them}")
    return Shown(pictures, view, "; ".join(notes))
