"""Serves a plan as a 3-D scene to the browser of this machine, and of no other."""

import importlib
import logging
import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from types import FrameType
from typing import Any

from skinplan.errors import PortBusyError, ViewerMissingError
from skinplan.view.scene import PlanScene
from skinplan.view.scene_data import SceneData

HOST = "127.0.0.1"
DEFAULT_PORT = 8080
_PORTS_TRIED = 20
_log = logging.getLogger(__name__)


class BrowserView:
    """A served scene; a context manager, stopped at its end.

    Attributes:
        port: Where it is served; the next free one when the one asked for was busy.
        scene: What is in it.
    """

    def __init__(self, data: SceneData, port: int = DEFAULT_PORT) -> None:
        """Starts the server and fills the scene.

        Args:
            data: What to show.
            port: Port on the loopback interface; the next 19 are tried too. 0 = any free one.

        Raises:
            ViewerMissingError: viser is not installed.
            PortBusyError: None of the ports is free.
        """
        viser = _viser()
        chosen = free_port(port)
        # The server announces itself on stdout, where a command may print JSON.
        with _quiet():
            self._server: Any = viser.ViserServer(
                host=HOST, port=chosen, label="skinplan", verbose=False
            )
        # A part's shape is nobody else's business: the page must not open a tunnel to the internet.
        self._server.request_share_url = lambda verbose=True: None
        self.port = int(self._server.get_port())
        self._stopped = False
        try:
            self.scene = PlanScene(self._server, data)
        except BaseException:
            self.stop()
            raise

    @property
    def url(self) -> str:
        """What to open in the browser."""
        return f"http://{HOST}:{self.port}"

    def __enter__(self) -> "BrowserView":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def wait(self) -> None:
        """Serves until the process is told to end: Ctrl+C, or SIGTERM in the main thread."""
        ended = threading.Event()
        with _on_signals(ended):
            try:
                # A wait without end would not notice Ctrl+C on every system.
                while not ended.wait(0.5):
                    pass
            except KeyboardInterrupt:
                _log.debug("interrupted: the view ends")

    def stop(self) -> None:
        """Ends the server; the port is free again. May be called twice."""
        if self._stopped:
            return
        self._stopped = True
        scene = getattr(self, "scene", None)
        if scene is not None and scene.clock is not None:
            scene.clock.stop()
        with _quiet():
            self._server.stop()


def require_viewer(port: int) -> None:
    """Makes sure that a scene can be served.

    Args:
        port: As for `BrowserView`.

    Raises:
        ViewerMissingError: viser is not installed.
        PortBusyError: No free port.
    """
    _viser()
    free_port(port)


def free_port(wanted: int) -> int:
    """Finds a free port of the loopback interface.

    Args:
        wanted: The first to try, 0 to 65535; 0 = any.

    Returns:
        The wanted port or one of the next 19.

    Raises:
        PortBusyError: None of them is free, or the number is no port.
    """
    if not 0 <= wanted <= 65535:
        raise PortBusyError(f"port {wanted} was asked for; 0 to 65535 are accepted")
    last = min(wanted + _PORTS_TRIED - 1, 65535) if wanted else 0
    for port in range(wanted, last + 1):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            # As the server does it: a port that a stopped server has just left counts as free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, port))
                return int(probe.getsockname()[1])
            except OSError:
                continue
    raise PortBusyError(
        f"port {wanted} was asked for; it and the ports up to {last} are busy or forbidden; "
        "another --port is accepted, 0 for any free one"
    )


def _viser() -> Any:
    try:
        return importlib.import_module("viser")
    except ImportError as error:
        raise ViewerMissingError(
            f"the view in the browser needs the package viser ({error}); "
            "install it with: pip install viser"
        ) from error


@contextmanager
def _quiet() -> Iterator[None]:
    with open(os.devnull, "w", encoding="utf-8") as nowhere, redirect_stdout(nowhere):
        yield


@contextmanager
def _on_signals(ended: threading.Event) -> Iterator[None]:
    """Ends on SIGINT and SIGTERM, also where a shell's ``&`` has made the process ignore SIGINT."""

    def end(_number: int, _frame: FrameType | None) -> None:
        ended.set()

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, end) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
