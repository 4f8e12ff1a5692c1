"""Camera, images, markers, pose of the part."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import PoseWithCovariance
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image
from skinplan_msgs import msg as messages

from skinplan.errors import ImageInvalidError, InputError
from skinplan.localization.model import CameraModel, Observation, WorkpiecePose
from skinplan.transforms import Array
from skinplan_nodes.conversions.geometry import (
    header_to_msg,
    pose_from_msg,
    pose_to_msg,
    require_frame,
    stamp_from_msg,
)

_CHANNELS = {"mono8": 1, "8UC1": 1, "bgr8": 3, "rgb8": 3}
_MODEL = "plumb_bob"


@dataclass(frozen=True, eq=False)
class LocatedPart:
    """Where the part is, as seen from one stand of the base.

    Attributes:
        T_arm_base_workpiece: shape (4, 4) [m].
        covariance: shape (6, 6), x y z [m] rx ry rz [rad] in arm_base.
        quality: E of eq (3).
        reprojection_error_px: Root mean square over all corners used [px].
        marker_ids: Markers used, shape (m,).
        stamp_s: Time of the image [s].
    """

    T_arm_base_workpiece: Array
    covariance: Array
    quality: float
    reprojection_error_px: float
    marker_ids: NDArray[np.int64]
    stamp_s: float

    @classmethod
    def from_camera(
        cls, pose: WorkpiecePose, T_arm_base_camera: Array, stamp_s: float
    ) -> "LocatedPart":
        """Maps a pose from the camera's optical frame to the arm base, eq (1).

        Args:
            pose: In the optical frame.
            T_arm_base_camera: Hand-eye calibration, shape (4, 4) [m].
            stamp_s: Time of the image [s].
        """
        turn = np.kron(np.eye(2), T_arm_base_camera[:3, :3])
        return cls(
            T_arm_base_camera @ pose.T_camera_workpiece,
            turn @ pose.covariance @ turn.T,
            pose.quality,
            pose.reprojection_error_px,
            pose.marker_ids,
            stamp_s,
        )


def camera_info_to_msg(camera: CameraModel, frame: str, stamp_s: float = 0.0) -> CameraInfo:
    """Converts a camera model; the image is not rectified."""
    projection = np.hstack([camera.K, np.zeros((3, 1))])
    return CameraInfo(
        header=header_to_msg(frame, stamp_s),
        width=camera.width,
        height=camera.height,
        distortion_model=_MODEL,
        d=np.asarray(camera.D, dtype=float).tolist(),
        k=np.asarray(camera.K, dtype=float).ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=projection.ravel().tolist(),
    )


def camera_info_from_msg(msg: CameraInfo) -> CameraModel:
    """Returns a camera model.

    Raises:
        ImageInvalidError: No size, another distortion model, numbers that are not finite, or no
            calibration.
    """
    K, D = np.array(msg.k, dtype=float).reshape(3, 3), np.array(msg.d, dtype=float)
    if msg.distortion_model not in ("", _MODEL):
        raise ImageInvalidError(
            f"camera info: distortion model {_MODEL} is accepted, found {msg.distortion_model!r}"
        )
    if (
        msg.width == 0
        or msg.height == 0
        or len(D) not in (0, 5)
        or not (K[0, 0] > 0 and K[1, 1] > 0)
    ):
        raise ImageInvalidError(
            f"camera info: a size, a focal length above 0 and 5 distortion coefficients or none "
            f"are accepted, found {msg.width} x {msg.height} px, focal lengths {K[0, 0]:g} and "
            f"{K[1, 1]:g} px, {len(D)} coefficients"
        )
    if not (np.isfinite(K).all() and np.isfinite(D).all()):
        raise ImageInvalidError("camera info: finite numbers are accepted, found others")
    return CameraModel(msg.width, msg.height, K, D)


def image_to_msg(image: NDArray[np.uint8], frame: str, stamp_s: float = 0.0) -> Image:
    """Converts an 8-bit image, shape (h, w) grey or (h, w, 3) BGR."""
    height, width = image.shape[:2]
    colour = image.ndim == 3
    return Image(
        header=header_to_msg(frame, stamp_s),
        height=height,
        width=width,
        encoding="bgr8" if colour else "mono8",
        is_bigendian=0,
        step=width * (3 if colour else 1),
        data=np.ascontiguousarray(image).tobytes(),
    )


def image_from_msg(msg: Image) -> NDArray[np.uint8]:
    """Returns an image, shape (h, w) grey or (h, w, 3) BGR.

    Raises:
        ImageInvalidError: An encoding that is not known, no pixels, or not as many bytes as the
            size says.
    """
    channels = _CHANNELS.get(msg.encoding)
    if channels is None:
        raise ImageInvalidError(
            f"image: the encodings {', '.join(_CHANNELS)} are accepted, found {msg.encoding!r}"
        )
    if (
        msg.width == 0
        or msg.height == 0
        or msg.step < msg.width * channels
        or len(msg.data) != msg.step * msg.height
    ):
        raise ImageInvalidError(
            f"image: {msg.width} x {msg.height} px of {channels} bytes in rows of {msg.step} bytes "
            f"were announced, found {len(msg.data)} bytes"
        )
    rows = np.frombuffer(msg.data, dtype=np.uint8).reshape(msg.height, msg.step)
    pixels = rows[:, : msg.width * channels].reshape(msg.height, msg.width, channels)
    if channels == 1:
        return pixels[:, :, 0]
    return pixels[:, :, ::-1] if msg.encoding == "rgb8" else pixels


def observations_to_msg(
    observations: Sequence[Observation], frame: str, stamp_s: float = 0.0, image_age_s: float = 0.0
) -> messages.MarkerObservations:
    """Converts the markers of one image."""
    return messages.MarkerObservations(
        header=header_to_msg(frame, stamp_s),
        observations=[
            messages.MarkerObservation(
                id=item.id,
                size=item.size_m,
                pose=pose_to_msg(item.T_camera_marker),
                reprojection_error=item.reprojection_error_px,
                ambiguity_ratio=item.ambiguity_ratio,
                distance=item.distance_m,
                angle=item.angle_rad,
                quality=item.quality,
            )
            for item in observations
        ],
        image_age=image_age_s,
    )


def observations_from_msg(msg: messages.MarkerObservations) -> tuple[Observation, ...]:
    """Returns the markers of one image; their corners are not in the message and are NaN.

    Raises:
        InputError: No frame, or a pose that is none.
    """
    if not msg.header.frame_id:
        raise InputError("marker observations: the camera's optical frame is accepted, found none")
    return tuple(
        Observation(
            item.id,
            item.size,
            np.full((4, 2), np.nan),
            pose_from_msg(item.pose),
            item.reprojection_error,
            item.ambiguity_ratio,
            item.distance,
            item.angle,
            item.quality,
        )
        for item in msg.observations
    )


def part_pose_to_msg(located: LocatedPart) -> messages.PartPose:
    """Converts where the part is."""
    return messages.PartPose(
        header=header_to_msg("arm_base", located.stamp_s),
        pose=PoseWithCovariance(
            pose=pose_to_msg(located.T_arm_base_workpiece),
            covariance=located.covariance.ravel().tolist(),
        ),
        quality=located.quality,
        reprojection_error=located.reprojection_error_px,
        marker_ids=located.marker_ids.tolist(),
    )


def part_pose_from_msg(msg: messages.PartPose) -> LocatedPart:
    """Returns where the part is.

    Raises:
        InputError: Another frame than arm_base, or a pose that is none.
    """
    require_frame(msg.header, "arm_base", "part pose")
    return LocatedPart(
        pose_from_msg(msg.pose.pose),
        np.array(msg.pose.covariance, dtype=float).reshape(6, 6),
        msg.quality,
        msg.reprojection_error,
        np.array(msg.marker_ids, dtype=np.int64),
        stamp_from_msg(msg.header.stamp),
    )
