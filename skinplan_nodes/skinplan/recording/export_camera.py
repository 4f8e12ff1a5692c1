"""Exports the images of a bag as MP4, one file per topic, with a table of their stamps."""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skinplan.errors import BagInvalidError, InputError
from skinplan.recording.model import BagTopic
from skinplan.recording.reader import BagReader
from skinplan.recording.tables import decoded, topics_of

_CHANNELS = {"mono8": 1, "8UC1": 1, "bgr8": 3, "8UC3": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4}
_TO_BGR = {
    "mono8": cv2.COLOR_GRAY2BGR,
    "8UC1": cv2.COLOR_GRAY2BGR,
    "rgb8": cv2.COLOR_RGB2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
}
_FASTEST_HZ = 120.0


def write_videos(reader: BagReader, folder: Path) -> Iterator[tuple[Path, int]]:
    """Writes the images of every camera topic.

    The rate of the file is the mean rate of the stamps; ``NAME.csv`` has each image's own stamp.

    Args:
        reader: The bag.
        folder: Where to write.

    Yields:
        File and number of images.

    Raises:
        InputError: The video can't be written on this machine.
        BagInvalidError: An image is damaged or of another form than the first one.
    """
    kinds = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
    for topic in topics_of(reader, *kinds):
        path = folder / f"{topic.name.strip('/').replace('/', '_')}.mp4"
        count = _write(reader, topic, path, _rate(reader, topic))
        if count:
            yield path, count


def _write(reader: BagReader, topic: BagTopic, path: Path, rate_hz: float) -> int:
    writer: Any = None
    size, count = (0, 0), 0
    try:
        with path.with_suffix(".csv").open("w", newline="", encoding="utf-8") as stream:
            stamps = csv.writer(stream)
            stamps.writerow(("frame", "time_s", "stamp_s"))
            for time_s, _, message in decoded(reader, [topic]):
                image = _image(topic.name, message)
                if writer is None:
                    size = (image.shape[1], image.shape[0])
                    codec = cv2.VideoWriter.fourcc(*"mp4v")
                    writer = cv2.VideoWriter(str(path), codec, rate_hz, size)
                    if not writer.isOpened():
                        raise InputError(f"{path}: OpenCV can't write an MP4 there")
                if (image.shape[1], image.shape[0]) != size:
                    raise BagInvalidError(f"{topic.name}: images of one size are accepted")
                writer.write(image)
                stamp = message["header"]["stamp"]
                stamps.writerow((count, time_s, stamp["sec"] + stamp["nanosec"] * 1e-9))
                count += 1
    finally:
        if writer is not None:
            writer.release()
    return count


def _rate(reader: BagReader, topic: BagTopic) -> float:
    first = next(iter(reader.messages([topic.name])), None)
    last = reader.last(topic.name, reader.info.end_ns)
    if first is None or not last or topic.messages < 2:
        return 1.0
    span_s = (last[0].log_time_ns - first.log_time_ns) * 1e-9
    return min(_FASTEST_HZ, (topic.messages - 1) / span_s) if span_s > 0.0 else 1.0


def _image(topic: str, message: dict[str, Any]) -> np.ndarray:
    """Returns an image as BGR, shape (h, w, 3)."""
    if "encoding" not in message:
        found = cv2.imdecode(message["data"], cv2.IMREAD_COLOR)
        if found is None:
            raise BagInvalidError(f"{topic}: JPEG or PNG is accepted, an image is neither")
        return found
    encoding, height, width = message["encoding"], message["height"], message["width"]
    channels = _CHANNELS.get(encoding)
    if channels is None:
        raise BagInvalidError(
            f"{topic}: images of {', '.join(_CHANNELS)} are accepted, found {encoding!r}"
        )
    step = message["step"] or width * channels
    if step < width * channels or len(message["data"]) < step * height or not height * width:
        raise BagInvalidError(f"{topic}: an image has too few bytes for its size")
    rows = message["data"][: step * height].reshape(height, step)[:, : width * channels]
    image = np.ascontiguousarray(rows).reshape(height, width, channels)
    if encoding not in _TO_BGR:
        return image
    return np.asarray(cv2.cvtColor(image, _TO_BGR[encoding]))
