"""Reads one SQLite file of rosbag2 (storage ``sqlite3``), of all its schema versions."""

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from skinplan.errors import BagInvalidError
from skinplan.recording.model import BagMessage, BagTopic
from skinplan.recording.qos import qos_profiles
from skinplan.recording.storage import LARGEST_PIECE, StorageInfo, naming_damage

_MAGIC = b"SQLite format 3\0"
_LAST_NS = 2**63 - 1
# Later schema versions have more of them.
_TOPIC_COLUMNS = (
    "id",
    "name",
    "type",
    "serialization_format",
    "offered_qos_profiles",
    "type_description_hash",
)


class SqliteStorage:
    """One open SQLite file, see `Storage`.

    Args:
        path: The file.

    Raises:
        BagInvalidError: No SQLite file of rosbag2.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with naming_damage(path), path.open("rb") as stream:
            if stream.read(len(_MAGIC)) != _MAGIC:
                raise BagInvalidError(f"{path}: an SQLite file is accepted, its first bytes differ")
        # What a recorder that is still running, or was cut off, keeps in the log beside the file
        # belongs to it; without such a log nothing may be written beside a bag of others.
        has_log = path.with_name(f"{path.name}-wal").exists()
        mode = "mode=ro" if has_log else "mode=ro&immutable=1"
        with self._naming_damage():
            uri = f"file:{quote(str(path))}?{mode}"
            self._base = sqlite3.connect(uri, uri=True, check_same_thread=False)
        try:
            with self._naming_damage():
                self._base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_PIECE)
                self._base.text_factory = lambda data: data.decode("utf-8", "replace")
                self._topics: dict[int, BagTopic] = self._read_topics()
                self._info = self._read_info()
        except BagInvalidError:
            self._base.close()
            raise

    @property
    def info(self) -> StorageInfo:
        """What is in it."""
        return self._info

    def close(self) -> None:
        """Closes the file."""
        self._base.close()

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[BagMessage]:
        """See `Storage`."""
        first = 0 if start_ns is None else min(start_ns, _LAST_NS)
        last = _LAST_NS if end_ns is None else min(end_ns, _LAST_NS)
        numbers = self._numbers(topics)
        if not numbers:
            return
        asked = (
            "SELECT topic_id, timestamp, data FROM messages WHERE timestamp >= ? AND timestamp < ?"
            f" AND topic_id IN ({','.join(map(str, numbers))}) ORDER BY timestamp, id"
        )
        with self._naming_damage():
            for row in self._base.execute(asked, (first, last)):
                yield self._message(row)

    def last(self, topic: str, at_ns: int, count: int) -> list[BagMessage]:
        """See `Storage`."""
        numbers = self._numbers([topic])
        asked = (
            "SELECT topic_id, timestamp, data FROM messages WHERE timestamp <= ?"
            f" AND topic_id IN ({','.join(map(str, numbers))})"
            " ORDER BY timestamp DESC, id DESC LIMIT ?"
        )
        with self._naming_damage():
            rows = list(self._base.execute(asked, (min(at_ns, _LAST_NS), count)))
            return [self._message(row) for row in reversed(rows)]

    def _numbers(self, topics: Collection[str] | None) -> list[int]:
        return [n for n, topic in self._topics.items() if topics is None or topic.name in topics]

    def _message(self, row: Any) -> BagMessage:
        number, at_ns, data = row
        topic = self._topics[number]
        if not isinstance(data, bytes) or not isinstance(at_ns, int) or at_ns < 0:
            raise ValueError(f"a message with bytes and a time is accepted, found {row!r:.80}")
        return BagMessage(topic.name, topic.type_name, data, at_ns, at_ns)

    def _read_topics(self) -> dict[int, BagTopic]:
        present = self._columns("topics")
        columns = [name if name in present else "''" for name in _TOPIC_COLUMNS]
        counted = dict(
            self._base.execute("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id")
        )
        definitions = self._definitions()
        found = {}
        for row in self._base.execute(f"SELECT {', '.join(columns)} FROM topics"):
            number, name, kind, encoding, qos, type_hash = row
            found[int(number)] = BagTopic(
                name=str(name),
                type_name=str(kind),
                messages=counted.get(number, 0),
                type_hash=str(type_hash),
                qos=qos_profiles(qos or ""),
                schema_text=definitions.get(kind, ""),
                encoding=str(encoding or "cdr"),
            )
        unknown = set(counted) - set(found)
        if unknown:
            raise ValueError(f"messages of topics {sorted(unknown)} that are not described")
        return found

    def _definitions(self) -> dict[str, str]:
        columns = self._columns("message_definitions")
        if "encoded_message_definition" not in columns or "topic_type" not in columns:
            return {}
        asked = "SELECT topic_type, encoded_message_definition FROM message_definitions"
        if "encoding" in columns:
            asked += " WHERE encoding = 'ros2msg'"
        return {str(kind): str(text) for kind, text in self._base.execute(asked)}

    def _read_info(self) -> StorageInfo:
        asked = "SELECT COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages"
        count, first, last = self._base.execute(asked).fetchone()
        metadata = ""
        if "metadata" in self._columns("metadata"):
            row = self._base.execute("SELECT metadata FROM metadata ORDER BY id DESC").fetchone()
            metadata = str(row[0]) if row else ""
        return StorageInfo(
            self._path,
            tuple(self._topics.values()),
            count,
            int(first or 0),
            int(last or 0),
            metadata=metadata,
        )

    def _columns(self, table: str) -> set[str]:
        return {str(row[1]) for row in self._base.execute(f"PRAGMA table_info({table})")}

    @contextmanager
    def _naming_damage(self) -> Iterator[None]:
        try:
            with naming_damage(self._path):
                yield
        except (sqlite3.Error, TypeError) as error:
            raise BagInvalidError(
                f"{self._path}: an SQLite file of rosbag2 is accepted ({error})"
            ) from error
