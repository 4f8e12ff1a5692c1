"""Which topics are recorded: by name, pattern and type, less what is excluded."""

import re
from dataclasses import dataclass

from skinplan.errors import BagNotWritableError


@dataclass(frozen=True)
class TopicSelection:
    """Which topics are recorded.

    Attributes:
        topics: Names; a name without a leading slash gets one.
        pattern: Regular expression that a whole name has to match; empty = none.
        types: ROS types. With topics and pattern empty, too, every topic is taken.
        exclude_topics: Names left out, whatever else takes them.
        exclude_pattern: Regular expression of names left out; empty = none.
        exclude_types: Types left out.
        include_hidden: Take topics with a part that begins with ``_`` or is ``truth`` as well; a
            hidden topic that ``topics`` names is taken without.
    """

    topics: tuple[str, ...] = ()
    pattern: str = ""
    types: tuple[str, ...] = ()
    exclude_topics: tuple[str, ...] = ()
    exclude_pattern: str = ""
    exclude_types: tuple[str, ...] = ()
    include_hidden: bool = False

    def __post_init__(self) -> None:
        for field in ("topics", "exclude_topics"):
            named = tuple(_absolute(name) for name in getattr(self, field))
            object.__setattr__(self, field, named)
        for pattern in (self.pattern, self.exclude_pattern):
            try:
                re.compile(pattern)
            except re.error as error:
                raise BagNotWritableError(
                    f"topics by the pattern {pattern!r} were asked for; a regular expression is "
                    f"accepted ({error})"
                ) from error

    def takes(self, topic: str, type_name: str) -> bool:
        """Tells whether a topic is recorded."""
        if topic in self.exclude_topics or type_name in self.exclude_types:
            return False
        if self.exclude_pattern and re.fullmatch(self.exclude_pattern, topic):
            return False
        if topic in self.topics:
            return True
        if not self.include_hidden and is_hidden(topic):
            return False
        if self.pattern and re.fullmatch(self.pattern, topic):
            return True
        if type_name in self.types:
            return True
        return not (self.topics or self.pattern or self.types)


def is_hidden(topic: str) -> bool:
    """Tells whether a topic is not for the bag unless somebody asks for it.

    ROS hides those of actions, ``ros2 bag`` leaves them out, too; what only a simulation can know
    (``truth/``) is for no node of the cell.
    """
    return any(part.startswith("_") or part == "truth" for part in topic.split("/"))


def _absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"
