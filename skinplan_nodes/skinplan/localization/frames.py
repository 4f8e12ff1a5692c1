"""The newest transforms between named frames."""

from skinplan.errors import FrameMissingError, InputError
from skinplan.transforms import Array, inverse, require_transform, transform


class TransformTree:
    """A tree of frames with the newest transform of each to its parent; nothing is interpolated."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Array, float]] = {}

    def set(self, parent: str, child: str, T_parent_child: Array, stamp_s: float) -> None:
        """Takes a transform; an older one than the known one is ignored.

        Args:
            parent: Name of the parent frame.
            child: Name of the child frame.
            T_parent_child: shape (4, 4) [m].
            stamp_s: Time that it holds for [s].

        Raises:
            InputError: A name is empty, both are the same, the transform is none, or the frames
                would no longer be a tree.
        """
        if not parent or not child or parent == child:
            raise InputError(
                f"two different frame names are accepted, found {parent!r} and {child!r}"
            )
        checked = require_transform(T_parent_child, f"transform {parent} to {child}")
        known = self._parents.get(child)
        if known is not None and known[0] == parent and known[2] > stamp_s:
            return
        if child in self._chain(parent):
            raise InputError(
                f"frame {child} can't hang below {parent}, which already hangs below it"
            )
        self._parents[child] = (parent, checked, float(stamp_s))

    def renew(self, child: str, stamp_s: float) -> None:
        """Takes it that a frame's transform to its parent still holds; see `set`.

        Args:
            child: Name of the frame, which is known.
            stamp_s: Time that it holds for [s].
        """
        parent, T_parent_child, known_s = self._parents[child]
        self._parents[child] = (parent, T_parent_child, max(known_s, float(stamp_s)))

    def lookup(self, target: str, source: str) -> Array:
        """Returns ``T_target_source``, shape (4, 4) [m].

        Raises:
            FrameMissingError: A frame is not known, or nothing connects the two.
        """
        known = self.frames
        for name in (target, source):
            if name not in known and target != source:
                raise FrameMissingError(
                    f"frame {name!r} was asked; known are {', '.join(known) or 'none'}"
                )
        up_source, up_target = self._chain(source), self._chain(target)
        common = next((name for name in up_source if name in up_target), None)
        if common is None:
            raise FrameMissingError(
                f"{target!r} from {source!r} was asked, but nothing connects them; known are "
                f"{', '.join(known)}"
            )
        return inverse(up_target[common]) @ up_source[common]

    def stamp(self, child: str) -> float:
        """Returns the time of a frame's transform to its parent [s].

        Raises:
            FrameMissingError: The frame has no parent.
        """
        if child not in self._parents:
            raise FrameMissingError(
                f"the age of frame {child!r} was asked; known are "
                f"{', '.join(self.frames) or 'none'}"
            )
        return self._parents[child][2]

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        names = set(self._parents) | {parent for parent, _, _ in self._parents.values()}
        return tuple(sorted(names))

    def _chain(self, name: str) -> dict[str, Array]:
        """Returns ``T_ancestor_name`` of the frame and all above it, nearest first."""
        pose: Array = transform()
        chain = {name: pose}
        while name in self._parents:
            parent, T_parent_child, _ = self._parents[name]
            pose = T_parent_child @ pose
            chain[parent] = pose
            name = parent
        return chain
