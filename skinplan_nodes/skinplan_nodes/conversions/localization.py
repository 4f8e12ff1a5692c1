"""Camera, images, markers, pose of the part."""

import cv2
import numpy as np
from geometry_msgs.msg import PoseWithCovariance
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from skinplan_msgs import msg as messages

from skinplan.errors import ImageInvalidError, InputError
from skinplan.localization.camera import require_camera
from skinplan.localization.chain import LocatedPart
from skinplan.localization.model import CameraModel, Observation, Sighting
from skinplan.localization.quality import quality_parts
from skinplan.robot.cell import QualitySettings
from skinplan_nodes.conversions.geometry import (
    header_to_msg,
    pose_from_msg,
    pose_to_msg,
    require_frame,
    stamp_from_msg,
)

_CHANNELS = {"mono8": 1, "8UC1": 1, "bgr8": 3, "rgb8": 3}
_MODELS = ("plumb_bob", "rational_polynomial")
_LARGEST_BYTES = 50_000_000


def camera_info_to_msg(camera: CameraModel, frame: str, stamp_s: float = 0.0) -> CameraInfo:
    """Converts a camera model; the image is not rectified."""
    projection = np.hstack([camera.K, np.zeros((3, 1))])
    return CameraInfo(
        header=header_to_msg(frame, stamp_s),
        width=camera.width,
        height=camera.height,
        distortion_model=_MODELS[1] if len(camera.D) == 8 else _MODELS[0],
        d=np.asarray(camera.D, dtype=float).tolist(),
        k=np.asarray(camera.K, dtype=float).ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=projection.ravel().tolist(),
    )


def camera_info_from_msg(msg: CameraInfo, rectified: bool = False) -> CameraModel:
    """Returns a camera model.

    Args:
        msg: The message; its region of interest and binning are taken into account.
        rectified: The images are rectified: K is that of the projection, there is no distortion.

    Raises:
        ImageInvalidError: No size, another distortion model, numbers that are not finite, or no
            calibration.
    """
    full = np.array(msg.k, dtype=float).reshape(3, 3)
    D = np.array(msg.d, dtype=float)
    if rectified:
        full, D = np.array(msg.p, dtype=float).reshape(3, 4)[:, :3], np.zeros(0)
    elif msg.distortion_model not in ("", *_MODELS):
        raise ImageInvalidError(
            f"camera info: the distortion models {', '.join(_MODELS)} are accepted, found "
            f"{msg.distortion_model!r}"
        )
    binning = np.maximum([msg.binning_x, msg.binning_y], 1)
    offset = np.array([msg.roi.x_offset, msg.roi.y_offset])
    size = np.array([msg.roi.width or msg.width, msg.roi.height or msg.height]) // binning
    K = full.copy()
    K[:2] /= binning[:, None]
    # The middle of the first pixel of a binned image is not that of the first full one.
    K[:2, 2] = (full[:2, 2] - offset + 0.5) / binning - 0.5
    return require_camera(CameraModel(int(size[0]), int(size[1]), K, D))


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
    if msg.encoding == "rgb8":
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), dtype=np.uint8)
    return pixels


def compressed_image_from_msg(msg: CompressedImage) -> NDArray[np.uint8]:
    """Returns an image from a compressed one (JPEG or PNG), shape (h, w) grey or (h, w, 3) BGR.

    Raises:
        ImageInvalidError: Nothing in it, far too much, or no image of 8 bit.
    """
    data = np.frombuffer(msg.data, dtype=np.uint8)
    if not 0 < data.size <= _LARGEST_BYTES:
        raise ImageInvalidError(
            f"compressed image: 1 to {_LARGEST_BYTES} bytes are accepted, found {data.size}"
        )
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None or image.dtype != np.uint8:
        raise ImageInvalidError(
            f"compressed image: JPEG or PNG of 8 bit is accepted, found {data.size} bytes of "
            f"format {msg.format!r} that are none"
        )
    if image.ndim == 3 and image.shape[2] == 4:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGRA2BGR), dtype=np.uint8)
    return np.asarray(image, dtype=np.uint8)


def observations_to_msg(
    sighting: Sighting,
    settings: QualitySettings,
    frame: str,
    stamp_s: float = 0.0,
    image_age_s: float = 0.0,
) -> messages.MarkerObservations:
    """Converts what one image shows.

    Args:
        sighting: What it shows.
        settings: Figures of eq (3) that its markers were judged by.
        frame: Optical frame of the camera.
        stamp_s: Time of the image [s].
        image_age_s: Its age when it was evaluated [s].
    """
    return messages.MarkerObservations(
        header=header_to_msg(frame, stamp_s),
        observations=[
            _observation_to_msg(item, settings, image_age_s) for item in sighting.markers
        ],
        unknown_ids=list(sighting.unknown),
        duplicate_ids=list(sighting.duplicates),
        mirrored_ids=list(sighting.mirrored),
        covered_ids=list(sighting.covered),
        image_age=image_age_s,
    )


def _observation_to_msg(
    item: Observation, settings: QualitySettings, image_age_s: float
) -> messages.MarkerObservation:
    facing, nearness = quality_parts(item.angle_rad, item.distance_m, settings)
    return messages.MarkerObservation(
        id=item.id,
        size=item.size_m,
        corners=item.corners.ravel().tolist(),
        pose=PoseWithCovariance(
            pose=pose_to_msg(item.T_camera_marker), covariance=item.covariance.ravel().tolist()
        ),
        reprojection_error=item.reprojection_error_px,
        second_pose=pose_to_msg(item.T_camera_second),
        second_reprojection_error=item.second_error_px,
        ambiguity_ratio=item.ambiguity_ratio,
        distance=item.distance_m,
        angle=item.angle_rad,
        facing=facing,
        nearness=nearness,
        quality=item.quality,
        alpha=settings.alpha,
        distance_min=settings.distance_min_m,
        distance_max=settings.distance_max_m,
        quality_threshold=settings.threshold,
        image_age=image_age_s,
    )


def observations_from_msg(msg: messages.MarkerObservations) -> Sighting:
    """Returns what one image shows; how well the corners are known is not in the message (NaN).

    Raises:
        InputError: No frame, or a pose that is none.
    """
    if not msg.header.frame_id:
        raise InputError("marker observations: the camera's optical frame is accepted, found none")
    markers = tuple(
        Observation(
            id=item.id,
            size_m=item.size,
            corners=np.array(item.corners, dtype=float).reshape(4, 2),
            corner_covariance=np.full((8, 8), np.nan),
            corner_floor_px=float("nan"),
            T_camera_marker=pose_from_msg(item.pose.pose),
            covariance=np.array(item.pose.covariance, dtype=float).reshape(6, 6),
            reprojection_error_px=item.reprojection_error,
            T_camera_second=pose_from_msg(item.second_pose),
            second_error_px=item.second_reprojection_error,
            ambiguity_ratio=item.ambiguity_ratio,
            distance_m=item.distance,
            angle_rad=item.angle,
            quality=item.quality,
        )
        for item in msg.observations
    )
    return Sighting(
        markers,
        tuple(msg.unknown_ids),
        tuple(msg.duplicate_ids),
        tuple(msg.mirrored_ids),
        tuple(msg.covered_ids),
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
