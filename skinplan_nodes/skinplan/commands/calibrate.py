"""The command ``skinplan calibrate``: the camera in the arm base from recorded pairs."""

import importlib.util
import json
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import yaml

from skinplan import console
from skinplan.commands.calibration import default_due
from skinplan.errors import InputError, PartInvalidError, SkinplanError
from skinplan.json_file import write_json
from skinplan.localization.hand_eye import HandEye, PosePair, calibrate
from skinplan.part.fields import Fields, pose_fields
from skinplan.robot.calibration import calibration_path, note_calibration
from skinplan.robot.cell import CellConfig, load_cell
from skinplan.transforms import inverse

_LARGEST_FILE_BYTES = 20_000_000
_KEYS = ("T_arm_base_tool0", "T_camera_marker")


def calibrate_camera(
    recording: Annotated[
        Path,
        typer.Argument(help="JSON file of pairs, or a bag.", show_default=False),
    ],
    cell: Annotated[
        Path | None, typer.Option("--cell", help="Cell file; without it the default cell.")
    ] = None,
    marker: Annotated[
        int, typer.Option(min=0, help="Id of the marker on the flange; of a bag only.")
    ] = 0,
    out: Annotated[
        Path | None, typer.Option(help="YAML file for the lines of the cell file.")
    ] = None,
    valid_days: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=3650,
            help="Note the calibration beside the cell file, to be valid for so long.",
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document on stdout.")
    ] = False,
) -> None:
    """Calibrate the camera against the arm (T_b_c) from pairs of flange and marker poses."""
    with console.command(as_json):
        config = load_cell(cell)
        if valid_days is not None and cell is None:
            raise InputError("--valid-days was given without a cell file; --cell is accepted")
        pairs = read_pairs(recording, marker, cell)
        found = calibrate(pairs)
        lines = cell_lines(found, config)
        if out is not None:
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(yaml.safe_dump(lines, sort_keys=False), encoding="utf-8")
        document = _document(found, lines)
        if as_json:
            console.print_json(document)
        else:
            _show(found, lines)
        if found.verdict == "poor":
            raise SkinplanError(
                f"the calibration is poor: pairs that it has not seen are off by "
                f"{1e3 * found.held_out_m:.2f} mm and {np.degrees(found.held_out_rad):.2f} deg; "
                f"stand still at every pose, turn the flange more, show the marker larger"
            )
        if valid_days is not None and cell is not None:
            _note(cell, found, document, valid_days)


def _note(cell: Path, found: HandEye, document: dict[str, Any], days: int) -> None:
    """Keeps the result beside the cell file, and notes it as the cell's calibration."""
    facts = calibration_path(cell)
    assert facts is not None
    made = datetime.now(UTC)
    result = cell.parent / f"hand_eye-{made.strftime('%Y%m%d-%H%M%S')}.json"
    write_json(result, document)
    due = default_due(made, days)
    note_calibration(facts, "hand_eye", result, made, due, found.held_out_m, "m")
    typer.echo(f"noted in {facts}: hand_eye until {due}", err=True)


def read_pairs(recording: Path, marker: int, cell: Path | None) -> list[PosePair]:
    """Reads pairs from a JSON file, or from a bag through the program that knows ROS.

    The JSON file is a list of ``{"T_arm_base_tool0": pose, "T_camera_marker": pose}``, each pose
    ``{"translation_m": [x, y, z], "rotation_xyzw": [x, y, z, w]}``.

    Raises:
        InputError: No such file, or what is in it can't be used.
    """
    if not recording.exists():
        raise InputError(f"pairs of poses in {recording} were asked for; there is no such file")
    if recording.is_dir() or recording.suffix == ".mcap":
        text = _from_bag(recording, marker, cell)
    else:
        text = _text_of(recording)
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{recording}: a JSON list of pairs is accepted: {error}") from error
    if not isinstance(values, list):
        raise InputError(f"{recording}: a JSON list of pairs is accepted, found another value")
    try:
        return [_pair(item, f"pairs[{k}]", recording.name) for k, item in enumerate(values)]
    except PartInvalidError as error:  # the reader of part files is used for the keys
        raise InputError(str(error)) from error


def cell_lines(found: HandEye, config: CellConfig) -> dict[str, Any]:
    """Returns what belongs into the cell file."""
    T_base_link_optical = config.T_base_link_arm_base @ found.T_arm_base_camera
    T_link_optical = inverse(config.camera.T_base_link_camera_link) @ (
        config.camera.T_base_link_optical
    )
    return {
        "camera": {
            "T_base_link_camera_link": pose_fields(T_base_link_optical @ inverse(T_link_optical)),
            "mounting_error_m": float(round(found.held_out_m, 6)),
            "mounting_error_rad": float(round(found.held_out_rad, 6)),
        }
    }


def _pair(item: object, place: str, source: str) -> PosePair:
    fields = Fields(item, place, source, _KEYS)
    return PosePair(fields.pose(_KEYS[0]), fields.pose(_KEYS[1]))


def _text_of(path: Path) -> str:
    if not path.is_file():
        raise InputError(f"pairs in {path} were asked for; a JSON file or a bag is accepted")
    if path.stat().st_size > _LARGEST_FILE_BYTES:
        raise InputError(
            f"{path} has {path.stat().st_size} bytes; up to {_LARGEST_FILE_BYTES} are accepted"
        )
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: a JSON text file is accepted: {error}") from error


def _from_bag(bag: Path, marker: int, cell: Path | None) -> str:
    if importlib.util.find_spec("rclpy") is None:
        raise InputError(
            "pairs from a bag need the Python module rclpy, which is not installed; "
            "`make setup` installs it"
        )
    command = [sys.executable, "-P", "-m", "skinplan_nodes.calibration_pairs", str(bag.absolute())]
    command += ["--marker", str(marker)]
    if cell is not None:
        command += ["--cell", str(cell.absolute())]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        raise InputError(lines[-1] if lines else f"pairs of {bag} can't be read")
    return done.stdout


def _document(found: HandEye, lines: dict[str, Any]) -> dict[str, Any]:
    return {
        "T_arm_base_camera": pose_fields(found.T_arm_base_camera),
        "T_tool0_marker": pose_fields(found.T_tool0_marker),
        "method": found.method,
        "verdict": found.verdict,
        "held_out": {"position_m": found.held_out_m, "angle_rad": found.held_out_rad},
        "methods": {
            name: {
                "position_m": float(m) if np.isfinite(m) else None,
                "angle_rad": float(rad) if np.isfinite(rad) else None,
            }
            for name, (m, rad) in found.methods.items()
        },
        "pairs": [
            {"position_m": None, "angle_rad": None}
            if k in found.outliers
            else {"position_m": float(m), "angle_rad": float(rad)}
            for k, (m, rad) in enumerate(zip(found.residual_m, found.residual_rad, strict=True))
        ],
        "outliers": list(found.outliers),
        "cell": lines,
    }


def _show(found: HandEye, lines: dict[str, Any]) -> None:
    rows = [
        (name + (" (chosen)" if name == found.method else ""), f"{1e3 * m:.3f}", _degrees(rad))
        for name, (m, rad) in found.methods.items()
    ]
    console.print_table("Held-out pairs, rms", ("method", "mm", "deg"), rows)
    rows = [
        (str(k), "left out", "")
        if k in found.outliers
        else (str(k), f"{1e3 * found.residual_m[k]:.3f}", _degrees(found.residual_rad[k]))
        for k in range(len(found.residual_m))
    ]
    console.print_table("Pairs", ("pair", "mm", "deg"), rows)
    typer.echo(f"verdict: {found.verdict}")
    typer.echo(yaml.safe_dump(lines, sort_keys=False).strip())


def _degrees(angle_rad: float) -> str:
    return f"{np.degrees(angle_rad):.3f}"
