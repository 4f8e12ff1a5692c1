"""What the commands say: results on stdout, progress on stderr, one sentence for every error."""

import json
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from skinplan.errors import InputError, SkinplanError, StageError
from skinplan.plan_record import plain

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2

stderr = Console(stderr=True)
_log = logging.getLogger(__name__)


@contextmanager
def command(as_json: bool) -> Iterator[None]:
    """Runs the body of a command: turns errors into one sentence and an exit code.

    Args:
        as_json: Errors are also printed as a JSON document on stdout.

    Raises:
        typer.Exit: With code 2 for bad input, 1 for a failure.
    """
    _prepare_logging()
    try:
        yield
    except KeyboardInterrupt:
        stderr.print("interrupted")
        raise typer.Exit(130) from None
    except (SkinplanError, OSError) as error:
        code = exit_code(error)
        stderr.print(f"[bold red]skinplan:[/] {_escaped(str(error))}", soft_wrap=True)
        if as_json:
            root = _root(error)
            findings = [vars(finding) for finding in getattr(root, "findings", ())]
            document = {"kind": type(root).__name__, "message": str(error)}
            print_json({"error": {**document, **({"findings": findings} if findings else {})}})
        raise typer.Exit(code) from None


def exit_code(error: Exception) -> int:
    """Returns 2 when the caller has to change the input, 1 otherwise."""
    return EXIT_BAD_INPUT if isinstance(_root(error), InputError) else EXIT_FAILED


def print_json(document: Mapping[str, Any]) -> None:
    """Prints one JSON document on stdout."""
    sys.stdout.write(json.dumps(plain(document), indent=2, allow_nan=False) + "\n")
    sys.stdout.flush()


def print_table(title: str, header: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Prints a table on stdout."""
    table = Table(title=title, title_justify="left", header_style="bold")
    for name in header:
        table.add_column(name)
    for row in rows:
        table.add_row(*(_escaped(str(cell)) for cell in row))
    Console().print(table)


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[float, str], None]]:
    """Shows a progress bar on a terminal; elsewhere one log line per change of the text.

    Yields:
        A callable that takes the share done, 0 to 1, and what is being done.
    """
    if not stderr.is_terminal:
        yield _LineProgress(title)
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
    )
    with Progress(*columns, TimeElapsedColumn(), console=stderr, transient=True) as bar:
        task = bar.add_task(title, total=1.0)
        yield lambda share, text: bar.update(
            task, completed=share, description=f"{title}: {_escaped(text)}"
        )


class _LineProgress:
    def __init__(self, title: str) -> None:
        self._title = title
        self._text = ""

    def __call__(self, share: float, text: str) -> None:
        if text != self._text:
            self._text = text
            stderr.print(
                f"{self._title}: {share:4.0%} {_escaped(text)}", highlight=False, soft_wrap=True
            )


def _root(error: Exception) -> Exception:
    return error.cause if isinstance(error, StageError) else error


def _escaped(text: str) -> str:
    return text.replace("[", r"\[")


def _prepare_logging() -> None:
    logging.basicConfig(
        level=logging.WARNING, stream=sys.stderr, format="%(levelname)s %(name)s: %(message)s"
    )
