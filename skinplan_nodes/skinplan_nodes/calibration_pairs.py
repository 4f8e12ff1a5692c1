"""Pairs of flange and marker poses from a bag, as JSON: of ``skinplan calibrate``."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from skinplan_msgs.msg import MarkerObservations

from skinplan.errors import BagInvalidError, InputError, SkinplanError
from skinplan.localization.model import Observation
from skinplan.part.fields import pose_fields
from skinplan.recording.reader import open_bag, read_messages
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import load_cell
from skinplan.transforms import Array
from skinplan_nodes.conversions import (
    joint_state_from_msg,
    observations_from_msg,
    stamp_from_msg,
)

# The arm rests when its joints differ by less than this over so long before and after an image.
_STILL_RAD, _STILL_S = 2e-4, 0.2


def pairs_of(bag: Path, marker: int, arm: ArmModel) -> list[tuple[Array, Array]]:
    """Returns flange in the arm base and marker in the camera, one pair per stand of the arm.

    Raises:
        InputError: The bag can't be read, or has no such pairs.
    """
    stamps, joints, seen = _recorded(bag, marker)
    if not len(stamps) or not seen:
        raise InputError(
            f"{bag}: joint_states and markers/observations of marker {marker} are accepted, found "
            f"{len(stamps)} joint states and {len(seen)} observations"
        )
    best: dict[tuple[int, ...], tuple[Array, Observation]] = {}
    for stamp_s, item in seen:
        near = np.abs(stamps - stamp_s) <= _STILL_S
        around = near.any() and stamps[near].min() <= stamp_s <= stamps[near].max()
        if not around or np.ptp(joints[near], axis=0).max() > _STILL_RAD:
            continue
        rest = joints[near].mean(axis=0)
        key = tuple(np.rint(rest / (5.0 * _STILL_RAD)).astype(int).tolist())
        if key not in best or item.reprojection_error_px < best[key][1].reprojection_error_px:
            best[key] = (rest, item)
    return [(arm.forward(rest[None])[0], item.T_camera_marker) for rest, item in best.values()]


def _recorded(bag: Path, marker: int) -> tuple[Array, Array, list[tuple[float, Observation]]]:
    """Reads joint states, shape (n,) [s] and (n, 6) [rad], and observations of one marker."""
    stamps: list[float] = []
    joints: list[Array] = []
    seen: list[tuple[float, Observation]] = []
    for message in read_messages(open_bag(bag)):
        name = message.topic.rsplit("/", 1)[-1]
        try:
            if name == "joint_states":
                state = deserialize_message(message.data, JointState)
                joints.append(joint_state_from_msg(state)[0])
                stamps.append(stamp_from_msg(state.header.stamp))
            elif message.topic.endswith("markers/observations"):
                found = deserialize_message(message.data, MarkerObservations)
                stamp_s = stamp_from_msg(found.header.stamp)
                markers = observations_from_msg(found).markers
                seen += [(stamp_s, item) for item in markers if item.id == marker]
        except SkinplanError:
            continue  # a state of other joints
        except Exception as error:
            raise BagInvalidError(f"{bag}: a message of {message.topic} is damaged") from error
    return np.array(stamps), np.array(joints).reshape(len(joints), -1), seen


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    parser = argparse.ArgumentParser(
        prog="python -m skinplan_nodes.calibration_pairs", description=__doc__
    )
    parser.add_argument("bag", type=Path, help="bag folder or MCAP file")
    parser.add_argument("--marker", type=int, default=0, help="id of the marker on the flange")
    parser.add_argument("--cell", type=Path, default=None, help="cell file")
    given = parser.parse_args(arguments)
    try:
        found = pairs_of(given.bag, given.marker, ArmModel.load(load_cell(given.cell)))
    except SkinplanError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    pairs = [
        {"T_arm_base_tool0": pose_fields(flange), "T_camera_marker": pose_fields(marker)}
        for flange, marker in found
    ]
    sys.stdout.write(json.dumps(pairs) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
