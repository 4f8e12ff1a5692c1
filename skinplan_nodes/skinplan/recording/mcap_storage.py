"""Reads the messages of one MCAP file: merged by time, filtered, or the last ones of a topic."""

from bisect import bisect_right
from collections.abc import Collection, Iterator
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode

from skinplan.errors import BagInvalidError
from skinplan.recording.mcap_blocks import HEAD, MESSAGE, Block, McapMap, chunk_data, read_map
from skinplan.recording.model import BagMessage, BagTopic
from skinplan.recording.qos import QosProfile, qos_profiles
from skinplan.recording.storage import StorageInfo, naming_damage

# Blocks that overlap in time wait in memory together, up to this [B].
_MOST_WAITING = 2**30
_LOG_TIME = itemgetter(0)
# Log time, publish time, channel, piece, begin and end of the message in it.
_Found = tuple[int, int, int, bytes | memoryview, int, int]


class McapStorage:
    """One open MCAP file, see `Storage`.

    Args:
        path: The file.

    Raises:
        BagInvalidError: No MCAP file, or nothing in it is readable.
    """

    def __init__(self, path: Path) -> None:
        with naming_damage(path):
            self._stream: BinaryIO = path.open("rb")
        try:
            self._map = read_map(path, self._stream)
            with naming_damage(path):
                self._info = _info(self._map)
        except BagInvalidError:
            self._stream.close()
            raise
        self._names = {
            number: (channel.topic, _type_name(self._map, number))
            for number, channel in self._map.channels.items()
        }

    @property
    def info(self) -> StorageInfo:
        """What is in it."""
        return self._info

    def close(self) -> None:
        """Closes the file."""
        self._stream.close()

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[BagMessage]:
        """See `Storage`."""
        wanted = self._channels(topics)
        first = 0 if start_ns is None else start_ns
        last = 2**64 if end_ns is None else end_ns
        blocks = [
            block
            for block in self._map.blocks
            if block.end_ns >= first
            and block.start_ns < last
            and (block.channels is None or not wanted.isdisjoint(block.channels))
        ]
        waiting: list[_Found] = []
        for number, block in enumerate(blocks):
            found = [item for item in self._read(block, wanted) if first <= item[0] < last]
            if waiting:
                self._require_little(waiting)
                found = sorted([*waiting, *found], key=_LOG_TIME)
            ready = len(found)
            if number + 1 < len(blocks):
                ready = bisect_right(found, blocks[number + 1].start_ns, key=_LOG_TIME)
            for item in found[:ready]:
                yield self._message(item)
            waiting = found[ready:]

    def last(self, topic: str, at_ns: int, count: int) -> list[BagMessage]:
        """See `Storage`."""
        wanted = self._channels([topic])
        found: list[_Found] = []
        # From the last block on, until no earlier one can have anything newer.
        for block in sorted(self._map.blocks, key=lambda block: block.end_ns, reverse=True):
            if block.start_ns > at_ns or not (block.channels is None or wanted & block.channels):
                continue
            if len(found) >= count and block.end_ns < found[-count][0]:
                break
            mine = [item for item in self._read(block, wanted) if item[0] <= at_ns]
            found = sorted([*mine, *found], key=_LOG_TIME)[-count:]
        return [self._message(item) for item in found]

    def _channels(self, topics: Collection[str] | None) -> frozenset[int]:
        return frozenset(
            number for number, (name, _) in self._names.items() if topics is None or name in topics
        )

    def _message(self, item: _Found) -> BagMessage:
        log_ns, publish_ns, channel, data, begin, end = item
        topic, type_name = self._names[channel]
        return BagMessage(topic, type_name, bytes(data[begin:end]), log_ns, publish_ns)

    def _read(self, block: Block, wanted: frozenset[int]) -> list[_Found]:
        """Returns the wanted messages of a block by log time."""
        with naming_damage(self._map.path):
            self._stream.seek(block.offset)
            data: bytes | memoryview = self._stream.read(block.length)
            if len(data) != block.length:
                raise EOFError(f"the block at byte {block.offset} breaks off")
            if block.is_chunk:
                opcode, length = HEAD.unpack_from(data)
                if opcode != Opcode.CHUNK or length != block.length - HEAD.size:
                    raise ValueError(f"no chunk of the announced size at byte {block.offset}")
                data = chunk_data(memoryview(data)[HEAD.size :])
            found = _found(data, wanted)
        if any(later[0] < earlier[0] for earlier, later in zip(found, found[1:], strict=False)):
            found.sort(key=_LOG_TIME)
        return found

    def _require_little(self, waiting: list[_Found]) -> None:
        if sum({id(item[3]): len(item[3]) for item in waiting}.values()) > _MOST_WAITING:
            raise BagInvalidError(
                f"{self._map.path}: chunks that overlap in time by up to {_MOST_WAITING} bytes "
                "are accepted, found more"
            )


def _found(data: bytes | memoryview, wanted: frozenset[int]) -> list[_Found]:
    """Returns the wanted messages of a piece in the order of the file."""
    found: list[_Found] = []
    head, message, is_message = HEAD.unpack_from, MESSAGE.unpack_from, int(Opcode.MESSAGE)
    place, size, skip = 0, len(data), MESSAGE.size
    while place < size:
        opcode, length = head(data, place)
        begin = place + 9
        place = begin + length
        if place > size:
            raise ValueError("a record breaks off")
        if opcode == is_message:
            channel, log_ns, publish_ns = message(data, begin)
            if channel in wanted:
                found.append((log_ns, publish_ns, channel, data, begin + skip, place))
    return found


def _type_name(found: McapMap, number: int) -> str:
    schema = found.schemas.get(found.channels[number].schema_id)
    return schema.name if schema else ""


def _info(found: McapMap) -> StorageInfo:
    topics: dict[str, BagTopic] = {}
    for number, channel in found.channels.items():
        known = topics.get(channel.topic)
        schema = found.schemas.get(channel.schema_id)
        mine = qos_profiles(channel.metadata.get("offered_qos_profiles", ""))
        qos: tuple[QosProfile, ...] = mine if known is None else known.qos + mine
        topics[channel.topic] = BagTopic(
            name=channel.topic,
            type_name=schema.name if schema else "",
            messages=found.counts.get(number, 0) + (known.messages if known else 0),
            type_hash=channel.metadata.get("topic_type_hash", ""),
            qos=qos,
            schema_text=schema.data.decode("utf-8", "replace") if schema else "",
            encoding=channel.message_encoding,
        )
    return StorageInfo(
        path=found.path,
        topics=tuple(topics.values()),
        messages=sum(found.counts.values()),
        start_ns=found.start_ns,
        end_ns=found.end_ns,
        complete=found.complete,
        metadata=found.metadata,
    )
