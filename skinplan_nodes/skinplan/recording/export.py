"""Exports a bag: tables as CSV or Parquet, clouds as PLY or LAZ, cameras as MP4."""

import csv
import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skinplan.errors import InputError
from skinplan.recording.export_camera import write_videos
from skinplan.recording.export_cloud import write_clouds
from skinplan.recording.reader import BagReader
from skinplan.recording.tables import TABLES, Table

#: What can be exported.
WHAT = (*TABLES, "cloud", "camera")
TABLE_FORMATS = ("csv", "parquet")
CLOUD_FORMATS = ("ply", "laz")
# Rows that wait in memory.
_BATCH = 50_000


@dataclass(frozen=True)
class Exported:
    """One file that was written.

    Attributes:
        path: The file.
        items: Rows, points or images in it.
    """

    path: Path
    items: int


def export_bag(
    bag: Path,
    folder: Path,
    what: Sequence[str] = WHAT,
    table_format: str = "csv",
    cloud_format: str = "ply",
    progress: Callable[[float, str], None] = lambda share, text: None,
) -> list[Exported]:
    """Exports a bag.

    Args:
        bag: Bag folder or storage file.
        folder: Where to write; created. Files of the same names are replaced.
        what: Of `WHAT`.
        table_format: ``csv`` or ``parquet``.
        cloud_format: ``ply`` or ``laz``.
        progress: Is told what is being written.

    Returns:
        The files; none for what the bag does not have.

    Raises:
        InputError: An unknown choice, a missing optional package, or a folder that can't be
            written.
        BagInvalidError: The bag is damaged or has no definitions of its types.
    """
    _require_choice("what to export", what, WHAT)
    _require_choice("the format of tables", [table_format], TABLE_FORMATS)
    _require_choice("the format of clouds", [cloud_format], CLOUD_FORMATS)
    write_table = _csv if table_format == "csv" else _parquet_writer()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"an export to {folder} was asked for ({error.strerror})") from error
    found: list[Exported] = []
    with BagReader(bag) as reader:
        for number, name in enumerate(what):
            progress(number / len(what), name)
            if name == "cloud":
                found += [Exported(*w) for w in write_clouds(reader, folder, cloud_format)]
            elif name == "camera":
                found += [Exported(*w) for w in write_videos(reader, folder)]
            else:
                table = TABLES[name](reader)
                path = folder / f"{table.name}.{table_format}"
                rows = write_table(table, path)
                if rows:
                    found.append(Exported(path, rows))
                else:
                    path.unlink(missing_ok=True)
    return found


def _require_choice(what: str, given: Iterable[str], accepted: Sequence[str]) -> None:
    for name in given:
        if name not in accepted:
            raise InputError(f"{what}: {', '.join(accepted)} are accepted, found {name!r}")


def _csv(table: Table, path: Path) -> int:
    count = 0
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, table.columns, extrasaction="ignore")
        writer.writeheader()
        for row in table.rows:
            writer.writerow(row)
            count += 1
    return count


def _parquet_writer() -> Callable[[Table, Path], int]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            "Parquet was asked for; it needs the package pyarrow, which `make extras` installs"
        ) from error

    def write(table: Table, path: Path) -> int:
        writer: Any = None
        count = 0
        while batch := list(itertools.islice(table.rows, _BATCH)):
            columns = {name: [row.get(name) for row in batch] for name in table.columns}
            made = pyarrow.table(columns, schema=writer.schema if writer else None)
            writer = writer or pyarrow.parquet.ParquetWriter(path, made.schema)
            writer.write_table(made)
            count += len(batch)
        if writer is not None:
            writer.close()
        return count

    return write
