"""The frame tree of the cell, and when the base moved last."""

import math
import threading
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from skinplan.errors import FrameMissingError, InputError, LocalizationError
from skinplan.localization.frames import TransformTree
from skinplan.transforms import Array, difference
from skinplan_nodes.conversions import stamp_from_msg, transform_stamped_from_msg

# Smaller differences between two poses of the base are noise of its odometry.
_STILL_M = 2e-4
_STILL_RAD = 2e-4


class Frames:
    """The frame tree of ``tf`` and ``tf_static``, and when the base moved last."""

    def __init__(self, base_frame: str = "base_link") -> None:
        self._base_frame = base_frame
        self._tree = TransformTree()
        self._lock = threading.Lock()
        # Child -> parent and numbers of its newest transform: most stand still most of the time.
        self._newest: dict[str, tuple[Any, ...]] = {}
        self._base: Array | None = None
        self._moved_s = 0.0
        self._known_s = math.inf
        self._on_base: Callable[[], None] | None = None

    def on_base(self, told: Callable[[], None]) -> None:
        """Has somebody told each time when a pose of the base was taken in."""
        self._on_base = told

    def take(self, msg: TFMessage) -> list[str]:
        """Takes transforms in; returns why some of them can't be used."""
        refused, based = [], False
        for item in msg.transforms:
            try:
                based |= self._take(item)
            except InputError as error:
                refused.append(str(error))
        if based and self._on_base is not None:
            self._on_base()
        return refused

    def _take(self, item: TransformStamped) -> bool:
        """Takes one transform in; returns whether it is a pose of the base."""
        moved, turned = item.transform.translation, item.transform.rotation
        numbers = (moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w)
        newest, child = (item.header.frame_id, *numbers), item.child_frame_id.lstrip("/")
        if self._newest.get(child) == newest:
            stamp_s = stamp_from_msg(item.header.stamp)
            with self._lock:
                self._tree.renew(child, stamp_s)
                if child == self._base_frame:
                    self._known_s = stamp_s
            return child == self._base_frame
        parent, child, T_parent_child, stamp_s = transform_stamped_from_msg(item)
        with self._lock:
            self._tree.set(parent, child, T_parent_child, stamp_s)
            if child == self._base_frame:
                self._watch(T_parent_child, stamp_s)
            if self._tree.stamp(child) <= stamp_s:
                # Neither refused nor older than what is known.
                self._newest[child] = newest
        return child == self._base_frame

    def lookup(self, target: str, source: str) -> Array:
        """Returns ``T_target_source``, shape (4, 4) [m].

        Raises:
            FrameMissingError: A frame is not known, or nothing connects the two.
        """
        try:
            with self._lock:
                return self._tree.lookup(target, source)
        except LocalizationError as error:
            raise FrameMissingError(str(error)) from error

    @property
    def moved_s(self) -> float:
        """Time of the last pose of the base that differed from the one before [s]."""
        with self._lock:
            return self._moved_s

    @property
    def known_s(self) -> float:
        """Time of the last pose of the base [s]; infinite = it has none that changes."""
        with self._lock:
            return self._known_s

    def _watch(self, T_parent_base: Array, stamp_s: float) -> None:
        self._known_s = stamp_s
        if self._base is not None:
            distance, angle = difference(self._base, T_parent_base)
            if distance < _STILL_M and angle < _STILL_RAD:
                return
        self._base, self._moved_s = T_parent_base, stamp_s
