"""Bags, as the rooms exchange them."""

from dataclasses import dataclass, field
from pathlib import Path

from skinplan.errors import BagNotWritableError
from skinplan.recording.qos import QosProfile


@dataclass(frozen=True)
class BagTopic:
    """One topic of a bag.

    Attributes:
        name: Topic, fully qualified.
        type_name: ROS type, e.g. ``std_msgs/msg/String``.
        messages: Number of messages.
        type_hash: RIHS01 hash of the type; empty = not recorded.
        qos: QoS that the publishers offered; empty = not recorded.
        schema_text: Definition of the type with its dependencies; empty = not recorded.
        encoding: Serialisation of the messages, ``cdr`` for ROS 2.
    """

    name: str
    type_name: str
    messages: int
    type_hash: str = ""
    qos: tuple[QosProfile, ...] = ()
    schema_text: str = ""
    encoding: str = "cdr"


@dataclass(frozen=True)
class BagInfo:
    """What is in a bag.

    Attributes:
        path: Folder or file that was opened.
        files: Storage files in the order of recording.
        topics: Topics by name.
        messages: Number of messages.
        start_ns: Log time of the first message [ns since the epoch]; 0 without messages.
        end_ns: Log time of the last message [ns since the epoch]; 0 without messages.
        bytes: Size of the storage files [B].
        complete: Every file was closed in order; False = what follows the last complete chunk is
            lost.
        custom_data: What the recorder wrote about the run.
    """

    path: Path
    files: tuple[Path, ...]
    topics: tuple[BagTopic, ...]
    messages: int
    start_ns: int
    end_ns: int
    bytes: int
    complete: bool
    custom_data: dict[str, str] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last message [s]."""
        return (self.end_ns - self.start_ns) * 1e-9


@dataclass(frozen=True)
class BagMessage:
    """One recorded message, still serialised.

    Attributes:
        topic: Topic.
        type_name: ROS type.
        data: Serialised message.
        log_time_ns: When it was received [ns since the epoch].
        publish_time_ns: When it was published [ns since the epoch].
    """

    topic: str
    type_name: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int


@dataclass(frozen=True)
class BagSummary:
    """What a finished recording holds.

    Attributes:
        folder: Bag folder.
        messages: Messages written.
        bytes: Size of the storage files [B].
        topics: Topics with at least one message.
        files: Storage files.
        repeated: Latched messages written again at the head of files; part of ``messages``.
        lost: Messages that the disk did not take, by topic.
        failure: Why the recording ended early; None = it did not.
    """

    folder: Path
    messages: int
    bytes: int
    topics: int
    files: int = 1
    repeated: int = 0
    lost: dict[str, int] = field(default_factory=dict)
    failure: BagNotWritableError | None = None
