"""Decodes serialised messages (CDR) by the definitions that a bag carries; needs no ROS.

A message becomes a dict; arrays of numbers become NumPy arrays, other arrays lists.
"""

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from skinplan.errors import BagInvalidError
from skinplan.recording.schema import SEPARATOR

_FIELD = re.compile(
    r"^(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?P<array>\[(?P<size>(?:<=)?\d*)\])?\s+"
    r"(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)$"
)
_NUMBERS = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_DEEPEST = 64
# Of a dependency: ``MSG: package/Type``.
_MSG = "MSG: "


@dataclass(frozen=True)
class _Field:
    name: str
    kind: str
    # None = one value, -1 = a sequence, else the length of the array.
    size: int | None


class CdrDecoder:
    """Decodes the messages of one type.

    Args:
        type_name: ROS type.
        schema_text: Its definition with dependencies, ``ros2msg``.

    Raises:
        BagInvalidError: The definition can't be understood, or there is none.
    """

    def __init__(self, type_name: str, schema_text: str) -> None:
        self._name = type_name
        parts = type_name.split("/")
        if len(parts) < 2 or not schema_text.strip():
            raise BagInvalidError(
                f"{type_name or 'a topic'}: a bag with the definitions of its types is accepted, "
                "this one has none"
            )
        self._types = _parsed(f"{parts[0]}/{parts[-1]}", schema_text)
        self._top = f"{parts[0]}/{parts[-1]}"

    def decode(self, data: bytes) -> dict[str, Any]:
        """Decodes one message.

        Raises:
            BagInvalidError: It is shorter than its definition says, or damaged.
        """
        try:
            if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
                raise ValueError(f"plain CDR is accepted, found head {data[:4].hex()}")
            return _Cursor(data, self._types).struct(self._top, 0)
        except (ValueError, struct.error, KeyError, RecursionError, MemoryError) as error:
            raise BagInvalidError(
                f"a message of type {self._name} can't be decoded ({error})"
            ) from error


class _Cursor:
    def __init__(self, data: bytes, types: dict[str, list[_Field]]) -> None:
        self._data = data
        self._order = "<" if data[1] & 1 else ">"
        self._types = types
        self._place = 4

    def struct(self, name: str, depth: int) -> dict[str, Any]:
        if depth > _DEEPEST:
            raise ValueError("definitions that contain themselves")
        fields = self._types[name]
        if not fields:
            self._place += 1  # a structure has at least one member
        return {field.name: self._field(field, depth) for field in fields}

    def _field(self, field: _Field, depth: int) -> Any:
        if field.size is None:
            return self._value(field.kind, depth)
        count = self._number("I") if field.size < 0 else field.size
        if field.kind in _NUMBERS:
            return self._numbers(_NUMBERS[field.kind], count)
        if count > len(self._data) - self._place:
            raise ValueError(f"{count} items in {len(self._data) - self._place} bytes")
        return [self._value(field.kind, depth) for _ in range(count)]

    def _value(self, kind: str, depth: int) -> Any:
        if kind in _NUMBERS:
            return self._number(_NUMBERS[kind])
        if kind == "string":
            return self._text()
        if kind == "wstring":
            raise ValueError("wide texts are not supported")
        return self.struct(kind, depth + 1)

    def _number(self, code: str) -> Any:
        size = struct.calcsize(code)
        self._align(size)
        (found,) = struct.unpack_from(self._order + code, self._data, self._place)
        self._place += size
        return found

    def _numbers(self, code: str, count: int) -> np.ndarray:
        kind = np.dtype(self._order + code)
        if count:
            self._align(kind.itemsize)
        found = np.frombuffer(self._data, kind, count, self._place) if count else np.empty(0, kind)
        self._place += count * kind.itemsize
        return found

    def _text(self) -> str:
        length = self._number("I")
        end = self._place + length
        if end > len(self._data):
            raise ValueError(f"a text of {length} bytes in {len(self._data) - self._place}")
        found = self._data[self._place : max(self._place, end - 1)]
        self._place = end
        return found.decode("utf-8", "replace")

    def _align(self, size: int) -> None:
        self._place += -(self._place - 4) % size


def _parsed(top: str, text: str) -> dict[str, list[_Field]]:
    types: dict[str, list[_Field]] = {}
    for number, section in enumerate(text.split(SEPARATOR)):
        lines = section.strip("\n").splitlines()
        name = top
        if number:
            if not lines or not lines[0].startswith(_MSG):
                raise BagInvalidError(f"{top}: a definition with its name is accepted")
            name = _short(lines.pop(0).removeprefix(_MSG).strip())
        types[name] = _fields(name.split("/")[0], lines)
    for name, fields in types.items():
        for field in fields:
            if field.kind not in types and field.kind not in (*_NUMBERS, "string", "wstring"):
                raise BagInvalidError(f"{top}: the definition of {field.kind} ({name}) is missing")
    return types


def _fields(package: str, lines: list[str]) -> list[_Field]:
    found = []
    for line in lines:
        match = _FIELD.match(line.split("#")[0].strip())
        if match is None or match["rest"].startswith("="):
            continue  # empty, or a constant
        kind = match["type"]
        if kind not in _NUMBERS and kind not in ("string", "wstring"):
            kind = _short(kind) if "/" in kind else f"{package}/{kind}"
        size: int | None = None
        if match["array"]:
            size = int(match["size"]) if match["size"].isdecimal() else -1
        found.append(_Field(match["name"], kind, size))
    return found


def _short(name: str) -> str:
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"


Decode = Callable[[bytes], dict[str, Any]]
