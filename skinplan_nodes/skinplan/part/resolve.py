"""Finds the part that a user means: a sample, a part file or a bare mesh."""

import dataclasses
import difflib
import re
from pathlib import Path
from urllib.parse import unquote, urlparse

from skinplan.errors import PartInvalidError, PartNotFoundError
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import FORMATS, load_mesh
from skinplan.part.defaults import default_fixture, default_placement
from skinplan.part.files import load_part, save_part
from skinplan.part.model import Part
from skinplan.part.samples import SAMPLES, sample_folder, write_sample

_ACCEPTED = (
    f"a sample ({', '.join(SAMPLES)}), a part.yaml, "
    f"or a mesh ({', '.join(suffix[1:].upper() for suffix in FORMATS)})"
)


def resolve_part(reference: str, unit: str | None = None, folder: Path | None = None) -> Part:
    """Finds a part by what a user, a job or a service request says.

    Args:
        reference: Name of a sample, path or ``file://`` URI of a part file, or path or URI of a
            mesh.
        unit: Unit of a bare mesh; None = metres. With a sample or a part file it must be theirs.
        folder: Where a bare mesh's part file is written, so that it has a URI; created when
            missing. None = not written.

    Returns:
        The part; a bare mesh gets the default fixture, placement and scan settings.

    Raises:
        PartNotFoundError: Nothing of that name.
        PartInvalidError: The part file can't be used, or its unit is another one than the one
            given.
        MeshError: The mesh can't be used.
    """
    if reference in SAMPLES:
        return _with_unit(_sample(reference), unit)
    path = _path(reference)
    if path.suffix.lower() in (".yaml", ".yml"):
        return _with_unit(load_part(path), unit)
    if path.suffix.lower() in FORMATS:
        return _bare(path, unit or "m", folder)
    if path.exists():
        raise PartNotFoundError(
            f"{reference} is neither a part file nor a mesh; accepted are {_ACCEPTED}"
        )
    near = difflib.get_close_matches(reference, SAMPLES, n=1)
    hint = f" (did you mean {near[0]}?)" if near else ""
    raise PartNotFoundError(f"no part {reference!r}{hint}; accepted are {_ACCEPTED}")


def _sample(name: str) -> Part:
    file = sample_folder() / name / "part.yaml"
    if file.is_file():
        return load_part(file)
    return write_sample(name, file.parent)


def _path(reference: str) -> Path:
    if not reference.strip() or "\0" in reference:
        raise PartNotFoundError(f"the part {reference!r} was asked for; accepted are {_ACCEPTED}")
    if "://" not in reference:
        return Path(reference).expanduser()
    parsed = urlparse(reference)
    if parsed.scheme != "file" or parsed.netloc not in ("", "localhost"):
        raise PartNotFoundError(
            f"{reference} is no file on this machine; file:///path/part.yaml is accepted"
        )
    return Path(unquote(parsed.path))


def _with_unit(part: Part, unit: str | None) -> Part:
    if unit is not None and unit != part.unit:
        raise PartInvalidError(
            f"unit {unit} was given for {part.id}, whose part file says {part.unit}; give no "
            "unit with a part file"
        )
    return part


def _bare(path: Path, unit: str, folder: Path | None) -> Part:
    mesh, _ = check_mesh(load_mesh(path, unit))
    name = re.sub(r"[^A-Za-z0-9_.-]", "_", path.stem)[:64] or "part"
    part = Part(
        id=name,
        mesh_path=path.resolve(),
        unit=unit,
        mesh_sha256=mesh.sha256,
        fixture=default_fixture(mesh.bounds),
        T_map_workpiece=default_placement(mesh.bounds),
    )
    if folder is None:
        return part
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PartInvalidError(f"the folder {folder} can't be made: {error.strerror}") from error
    return dataclasses.replace(part, source=save_part(part, folder / "part.yaml"))
