"""Writes a rosbag2 bag.

One MCAP file with zstd chunks, QoS per channel, the rosbag2 metadata record, and
``metadata.yaml``.

Nothing waits in memory for more than a second: what a power cut can take is the last second.
"""

import logging
import os
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from skinplan.errors import BagNotWritableError
from skinplan.recording.metadata import (
    RECORD_NAME,
    FileFigures,
    metadata_document,
    metadata_text,
    write_metadata,
)
from skinplan.recording.model import BagSummary, BagTopic
from skinplan.recording.qos import QosProfile, qos_text

_LOG = logging.getLogger(__name__)
_COMPRESSIONS = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}


@dataclass(frozen=True)
class BagSettings:
    """How a bag is written.

    Attributes:
        compression: ``zstd``, ``lz4`` or ``none``.
        chunk_bytes: A chunk is closed when it is larger than this [B].
        flush_s: A chunk is closed and brought to the disk when it is older than this, wall time
            [s].
        ros_distro: Name of the ROS distribution whose types are recorded.
    """

    compression: str = "zstd"
    chunk_bytes: int = 2**20
    flush_s: float = 0.5
    ros_distro: str = "jazzy"


@dataclass
class _Channel:
    id: int
    topic: BagTopic
    messages: int = 0


class BagWriter:
    """Writes one bag; a context manager. All methods may be called from any thread.

    Args:
        folder: Bag folder; created, must not exist or be empty.
        metadata: Facts about the run, kept as ``custom_data``.
        settings: How to write.

    Raises:
        BagNotWritableError: The folder is not empty, or can't be created.
    """

    def __init__(
        self,
        folder: Path,
        metadata: Mapping[str, str] | None = None,
        settings: BagSettings | None = None,
    ) -> None:
        self.settings = settings or BagSettings()
        if self.settings.compression not in _COMPRESSIONS:
            raise BagNotWritableError(
                f"compression {self.settings.compression!r} was asked for; one of "
                f"{', '.join(_COMPRESSIONS)} is accepted"
            )
        self.folder = Path(folder).absolute()
        self._custom_data = {str(key): str(value) for key, value in (metadata or {}).items()}
        self._channels: dict[str, _Channel] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._start_ns = 2**63 - 1
        self._end_ns = 0
        self._summary: BagSummary | None = None
        self._failure: BagNotWritableError | None = None
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self._path, self._stream = _create(self.folder)
        self._writer = self._open_writer()
        self._flusher = threading.Thread(target=self._flush_often, name="bag flusher", daemon=True)
        self._flusher.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.finish()

    def add_topic(
        self,
        name: str,
        type_name: str,
        schema_text: str,
        type_hash: str = "",
        qos: Sequence[QosProfile] = (),
    ) -> int:
        """Announces a topic.

        Args:
            name: Topic, fully qualified.
            type_name: ROS type.
            schema_text: Definition with dependencies, see `schema_with_dependencies`.
            type_hash: RIHS01 hash; empty = unknown.
            qos: QoS that the publishers offer.

        Returns:
            Number of the channel; the one it has already when the topic is known with the same
            type.

        Raises:
            BagNotWritableError: The topic is known with another type, or the bag is closed.
        """
        with self._lock:
            self._require_open()
            known = self._channels.get(name)
            if known is not None and known.topic.type_name != type_name:
                raise BagNotWritableError(
                    f"topic {name} of type {type_name} was asked for, but the bag has it with "
                    f"type {known.topic.type_name}"
                )
            if known is not None:
                return known.id
            topic = BagTopic(name, type_name, 0, type_hash, tuple(qos), schema_text)
            self._channels[name] = _Channel(self._register(topic), topic)
            return self._channels[name].id

    def write(
        self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Writes one serialised message.

        Args:
            topic: A topic announced before.
            data: Serialised message.
            log_time_ns: When it was received [ns since the epoch], >= 0.
            publish_time_ns: When it was published [ns since the epoch]; None = as received.

        Raises:
            BagNotWritableError: The topic is unknown, the time is negative, the bag is closed, or
                the disk does not take it.
        """
        published = log_time_ns if publish_time_ns is None else publish_time_ns
        if log_time_ns < 0 or published < 0:
            raise BagNotWritableError(
                f"{topic}: a time from 0 is accepted, found {log_time_ns} and {published} ns"
            )
        with self._lock:
            self._require_open()
            channel = self._channels.get(topic)
            if channel is None:
                raise BagNotWritableError(
                    f"topic {topic} was not announced; known are {', '.join(self._channels)}"
                )
            try:
                self._writer.add_message(channel.id, log_time_ns, data, published, channel.messages)
            except OSError as error:
                raise self._failed(error) from error
            channel.messages += 1
            self._start_ns = min(self._start_ns, log_time_ns)
            self._end_ns = max(self._end_ns, log_time_ns)

    def flush(self) -> None:
        """Closes the chunk in progress and brings it to the disk."""
        with self._lock:
            if self._summary is not None or self._failure is not None:
                return
            try:
                self._writer.flush()
            except OSError as error:
                raise self._failed(error) from error
        # Outside of the lock: a slow disk must not hold up the writers.
        os.fdatasync(self._stream.fileno())

    def finish(self) -> BagSummary:
        """Closes the bag; a second call returns the same.

        Returns:
            What it holds.

        Raises:
            BagNotWritableError: The disk does not take it. What was flushed before stays readable.
        """
        self._stopped.set()
        self._flusher.join()
        with self._lock:
            if self._summary is not None:
                return self._summary
            if self._failure is not None:
                self._stream.close()
                raise self._failure
            try:
                return self._close()
            except OSError as error:
                raise self._failed(error) from error
            finally:
                self._stream.close()

    @property
    def messages(self) -> int:
        """Messages written so far."""
        return sum(channel.messages for channel in self._channels.values())

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics announced so far."""
        return tuple(self._channels)

    def _open_writer(self) -> Writer:
        writer = Writer(
            self._stream,
            chunk_size=self.settings.chunk_bytes,
            compression=_COMPRESSIONS[self.settings.compression],
        )
        try:
            writer.start(profile="ros2", library="skinplan")
            writer.add_metadata(
                RECORD_NAME, {"serialized_metadata": metadata_text(self._document())}
            )
            self._stream.flush()
        except OSError as error:
            raise self._failed(error) from error
        return writer

    def _register(self, topic: BagTopic) -> int:
        key = (topic.type_name, topic.schema_text)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(
                topic.type_name, SchemaEncoding.ROS2, topic.schema_text.encode()
            )
        return self._writer.register_channel(
            topic.name,
            MessageEncoding.CDR,
            self._schemas[key],
            {"offered_qos_profiles": qos_text(topic.qos), "topic_type_hash": topic.type_hash},
        )

    def _document(self) -> dict[str, object]:
        messages = self.messages
        file = FileFigures(self._path.name, messages, self._start_ns, self._end_ns)
        topics = [
            replace(channel.topic, messages=channel.messages) for channel in self._channels.values()
        ]
        return metadata_document([file], topics, self._custom_data, self.settings.ros_distro)

    def _close(self) -> BagSummary:
        document = self._document()
        self._writer.flush()
        self._writer.add_metadata(RECORD_NAME, {"serialized_metadata": metadata_text(document)})
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        write_metadata(self.folder, document)
        used = sum(channel.messages > 0 for channel in self._channels.values())
        self._summary = BagSummary(self.folder, self.messages, self._path.stat().st_size, used)
        return self._summary

    def _flush_often(self) -> None:
        due = time.monotonic() + self.settings.flush_s
        while not self._stopped.wait(max(0.0, due - time.monotonic())):
            due = time.monotonic() + self.settings.flush_s
            try:
                self.flush()
            except (BagNotWritableError, OSError, ValueError) as error:
                _LOG.error("recording to %s: %s", self._path, error)
                return

    def _require_open(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._summary is not None or self._stopped.is_set():
            raise BagNotWritableError(f"{self.folder} is closed; nothing more can be written")

    def _failed(self, error: OSError) -> BagNotWritableError:
        self._failure = BagNotWritableError(
            f"{self.folder}: the bag can't be written ({error.strerror or error}); up to here "
            f"{self.messages} messages"
        )
        return self._failure


def _create(folder: Path) -> tuple[Path, BinaryIO]:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise BagNotWritableError(
                f"a bag in {folder} was asked for, but the folder is not empty; a new or empty "
                "folder is accepted"
            )
        path = folder / f"{folder.name}_0.mcap"
        return path, path.open("xb")
    except OSError as error:
        raise BagNotWritableError(
            f"a bag in {folder} was asked for, but it can't be created ({error.strerror or error})"
        ) from error
