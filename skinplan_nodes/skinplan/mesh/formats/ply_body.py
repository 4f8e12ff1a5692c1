"""The body of a PLY file: values by their place.

A place counts bytes in a binary file and numbers in a text.
"""

import struct
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skinplan.mesh.formats.raw import FormatError, Indices
from skinplan.transforms import Array

_BATCH = 1_000_000
_STRUCT_CODES = {
    "i1": "b",
    "u1": "B",
    "i2": "h",
    "u2": "H",
    "i4": "i",
    "u4": "I",
    "f4": "f",
    "f8": "d",
}


class Body(ABC):
    """Values by their place.

    Attributes:
        size: Places in all.
    """

    size: int

    @abstractmethod
    def width(self, code: str) -> int:
        """Returns how many places a value of a type takes."""

    @abstractmethod
    def take(self, starts: Indices, code: str, count: int) -> NDArray[Any]:
        """Returns `count` values of a type from each of the places, shape (n, count)."""

    def count(self, place: int, code: str) -> int:
        """Returns the length of a list that stands at a place.

        Raises:
            FormatError: It is none.
        """
        if place + self.width(code) > self.size:
            raise FormatError("it ends in the middle of an element")
        found = self._value(place, code)
        if not 0 <= found <= self.size or found != int(found):
            raise FormatError(f"a list of {found:g} values")
        return int(found)

    @abstractmethod
    def _value(self, place: int, code: str) -> float:
        """Returns the number at a place that exists."""


class BinaryBody(Body):
    """The body of a binary file."""

    def __init__(self, data: NDArray[np.uint8], order: str) -> None:
        """Looks at the bytes.

        Args:
            data: The body, shape (size,).
            order: Byte order, ``<`` or ``>``.
        """
        self.size = len(data)
        self._data = data
        self._order = order

    def width(self, code: str) -> int:
        """Returns how many bytes a value of a type takes."""
        return int(code[1])

    def take(self, starts: Indices, code: str, count: int) -> NDArray[Any]:
        """Returns `count` values of a type from each of the places, shape (n, count)."""
        kind = np.dtype(self._order + code)
        values = np.empty((len(starts), count), dtype=kind)
        within = np.arange(count * kind.itemsize)
        step = max(1, _BATCH // max(1, len(within)))
        for begin in range(0, len(starts), step):
            part = slice(begin, begin + step)
            chosen = self._data[starts[part, None] + within]
            values[part] = np.ascontiguousarray(chosen).view(kind)
        return values

    def _value(self, place: int, code: str) -> float:
        return float(
            struct.unpack_from(self._order + _STRUCT_CODES[code], self._data.data, place)[0]
        )


class TextBody(Body):
    """The body of a text file."""

    def __init__(self, values: Array) -> None:
        """Looks at the numbers, shape (size,)."""
        self.size = len(values)
        self._values = values

    def width(self, code: str) -> int:
        """Returns 1: the type does not matter."""
        return 1

    def take(self, starts: Indices, code: str, count: int) -> NDArray[Any]:
        """Returns `count` numbers from each of the places, shape (n, count)."""
        return self._values[starts[:, None] + np.arange(count)]

    def _value(self, place: int, code: str) -> float:
        return float(self._values[place])
