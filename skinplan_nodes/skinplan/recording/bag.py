"""Writes a rosbag2 bag of MCAP files.

Nothing waits in memory for longer than `BagSettings.flush_s`: what a killed process or a power cut
can take is less than the last second. Chunks go to the disk whole, and `skinplan.recording.heal`
closes what was cut off.
"""

import logging
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from skinplan.errors import BagNotWritableError
from skinplan.recording.bag_files import BagFiles, RecordedTopic, names
from skinplan.recording.bag_settings import BagSettings
from skinplan.recording.chunk import ChunkBuilder, compressor
from skinplan.recording.disk import write_error
from skinplan.recording.model import BagSummary, BagTopic
from skinplan.recording.qos import QosProfile

__all__ = ["BagSettings", "BagWriter"]

_LOG = logging.getLogger(__name__)


class BagWriter:
    """Writes one bag; a context manager. All methods may be called from any thread.

    Args:
        folder: Bag folder; created, must not exist or be empty. A bag that can't begin leaves none.
        metadata: Facts about the run, kept as ``custom_data``.
        settings: How to write.

    Attributes:
        settings: How it is written.
        folder: Bag folder.
        repeated: Latched messages written again at the head of files so far.

    Raises:
        BagNotWritableError: The folder is not empty, or can't be created.
        DiskFullError: The disk has too little left.
    """

    def __init__(
        self,
        folder: Path,
        metadata: Mapping[str, str] | None = None,
        settings: BagSettings | None = None,
    ) -> None:
        self.settings = settings or BagSettings()
        self.folder = Path(folder).absolute()
        self.repeated = 0
        self._compression, self._compress = compressor(self.settings.compression)
        self._chunk = ChunkBuilder()
        self._summary: BagSummary | None = None
        self._failure: BagNotWritableError | None = None
        self._file_start_ns: int | None = None
        self._described: set[int] = set()
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        custom_data = {str(key): str(value) for key, value in (metadata or {}).items()}
        self._files = BagFiles(
            self.folder, custom_data, self.settings.ros_distro, self.settings.least_free_bytes
        )
        self._files.begin()
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
        """Announces a topic, or what its publishers offer by now.

        Args:
            name: Topic, fully qualified.
            type_name: ROS type.
            schema_text: Definition with dependencies, see `schema_with_dependencies`.
            type_hash: RIHS01 hash; empty = unknown.
            qos: QoS that the publishers offer. Those of the first call stand in the bag; later ones
                say only whether the last message is written again at the head of the next file.

        Returns:
            Number of the channel; the one it has already when the topic is known with the same
            type.

        Raises:
            BagNotWritableError: The topic is known with another type, the bag is closed, or the
                disk does not take it.
        """
        with self._lock:
            self._require_open()
            known = self._files.topics.get(name)
            if known is not None and known.topic.type_name != type_name:
                raise BagNotWritableError(
                    f"topic {name} of type {type_name} was asked for, but the bag has it with "
                    f"type {known.topic.type_name}"
                )
            if known is not None:
                known.offer(tuple(qos) or known.topic.qos)
                return known.id
            topic = BagTopic(name, type_name, 0, type_hash, tuple(qos), schema_text)
            try:
                self._files.add_topic(topic)
            except BagNotWritableError as error:
                raise self._failed(error) from error
            return self._files.topics[name].id

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
                the disk does not take it: then it counts as lost.
        """
        published = log_time_ns if publish_time_ns is None else publish_time_ns
        if log_time_ns < 0 or published < 0:
            raise BagNotWritableError(
                f"{topic}: a time from 0 is accepted, found {log_time_ns} and {published} ns"
            )
        with self._lock:
            known = self._files.topics.get(topic)
            if self._failure is not None and known is not None:
                known.messages += 1
                known.lost += 1
            self._require_open()
            if known is None:
                raise BagNotWritableError(
                    f"topic {topic} was not announced; known are "
                    f"{names(self._files.topics.values())}"
                )
            try:
                if self._is_split_due(log_time_ns):
                    self._split(log_time_ns)
            except BagNotWritableError as error:
                known.messages += 1
                known.lost += 1
                raise self._failed(error) from error
            try:
                self._take(known, data, log_time_ns, published)
            except BagNotWritableError as error:
                raise self._failed(error) from error

    def split(self, log_time_ns: int) -> Path:
        """Begins the next file now.

        Args:
            log_time_ns: Log time of the latched messages that are written again at its head [ns].

        Returns:
            The file that was closed.

        Raises:
            BagNotWritableError: The bag is closed, or the disk does not take it.
        """
        with self._lock:
            self._require_open()
            closed = self._files.current.path
            try:
                self._split(max(0, log_time_ns))
            except BagNotWritableError as error:
                raise self._failed(error) from error
            return closed

    def note(self, key: str, value: str) -> None:
        """Adds a fact that is known only now to ``custom_data``."""
        with self._lock:
            self._files.custom_data[key] = value

    def flush(self) -> None:
        """Closes the chunk in progress and brings it to the disk.

        Raises:
            BagNotWritableError: The disk does not take it.
        """
        with self._lock:
            if self._summary is not None or self._failure is not None:
                return
            file = self._files.current
            try:
                self._seal()
            except BagNotWritableError as error:
                raise self._failed(error) from error
        try:
            # Outside of the lock: a slow disk must not hold up the writers.
            file.sync()
        except OSError as error:
            with self._lock:
                raise self._failed(write_error(file.path, error)) from error

    def finish(self) -> BagSummary:
        """Closes the bag; a second call returns the same.

        Also after the disk was full: what is there is closed in order, and ``failure`` of the
        summary says why it is not more.

        Returns:
            What it holds.

        Raises:
            BagNotWritableError: Not even the end could be written. What was flushed before stays
                readable, and `heal_bag` closes it.
        """
        self._stopped.set()
        self._flusher.join()
        with self._lock:
            if self._summary is None:
                self._close()
            assert self._summary is not None
            return self._summary

    @property
    def messages(self) -> int:
        """Messages written so far, without those that the disk did not take."""
        return sum(known.messages - known.lost for known in [*self._files.topics.values()])

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics announced so far."""
        return tuple(self._files.topics)

    @property
    def failure(self) -> BagNotWritableError | None:
        """Why nothing more can be written; None = all is well."""
        return self._failure

    def count(self, topic: str) -> int:
        """Returns the messages of a topic taken so far."""
        known = self._files.topics.get(topic)
        return 0 if known is None else known.messages

    def _take(self, known: RecordedTopic, data: bytes, log_ns: int, publish_ns: int) -> None:
        if self._file_start_ns is None:
            self._file_start_ns = log_ns
        if known.latched:
            known.last = (known.messages, publish_ns, data)
        self._describe(known)
        self._chunk.add(known.id, known.messages, log_ns, publish_ns, data)
        known.messages += 1
        if self._chunk.size >= self.settings.chunk_bytes:
            self._seal()

    def _describe(self, known: RecordedTopic) -> None:
        """Puts a topic's description into the first chunk that needs it: a CRC covers it there."""
        if known.id not in self._described:
            self._described.add(known.id)
            self._chunk.add_description(self._files.description(known))

    def _seal(self) -> None:
        if not self._chunk.empty:
            chunk, self._chunk = self._chunk, ChunkBuilder()
            self._files.add_chunk(chunk.seal(self._compression, self._compress))

    def _is_split_due(self, log_time_ns: int) -> bool:
        if self._file_start_ns is None:
            return False
        settings, size = self.settings, self._files.content_bytes
        if 0 < settings.split_bytes <= size:
            return True
        age_s = (log_time_ns - self._file_start_ns) * 1e-9
        return 0.0 < settings.split_s <= age_s

    def _split(self, log_time_ns: int) -> None:
        self._seal()
        self._files.end_file()
        self._files.open_next()
        self._file_start_ns = None
        self._described.clear()
        for known in self._files.topics.values():
            if known.last is not None:
                # The same sequence number tells a reader that it is the same message.
                sequence, publish_ns, data = known.last
                self._describe(known)
                self._chunk.add(known.id, sequence, log_time_ns, publish_ns, data)
                self.repeated += 1
                known.messages += 1

    def _close(self) -> None:
        try:
            if self._failure is None:
                self._seal()
        except BagNotWritableError as error:
            self._failed(error)
        try:
            self._files.end()
        finally:
            self._files.current.close()
        topics = self._files.topics.values()
        self._summary = BagSummary(
            folder=self.folder,
            messages=self.messages,
            bytes=self._files.bytes_done,
            topics=sum(known.messages > known.lost for known in topics),
            files=len(self._files.done),
            repeated=self.repeated,
            lost={known.topic.name: known.lost for known in topics if known.lost},
            failure=self._failure,
        )

    def _flush_often(self) -> None:
        due = time.monotonic() + self.settings.flush_s
        while not self._stopped.wait(max(0.0, due - time.monotonic())):
            due = time.monotonic() + self.settings.flush_s
            try:
                self.flush()
            except BagNotWritableError as error:
                _LOG.error("recording: %s", error)
                return

    def _require_open(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._summary is not None or self._stopped.is_set():
            raise BagNotWritableError(f"{self.folder} is closed; nothing more can be written")

    def _failed(self, error: BagNotWritableError) -> BagNotWritableError:
        """Keeps the first reason, with what the bag holds up to there."""
        if self._failure is None:
            # What is in memory goes down with it.
            for known in self._files.topics.values():
                known.lost += self._chunk.counts.get(known.id, 0)
            self._chunk = ChunkBuilder()
            self._failure = type(error)(f"{error}; up to here {self.messages} messages")
        return self._failure
