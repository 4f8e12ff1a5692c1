"""Which topics of a bag are meant: by name and by pattern, with exceptions."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from skinplan.errors import InputError


@dataclass(frozen=True)
class TopicFilter:
    """A choice of topics; without names and patterns all are chosen.

    Attributes:
        topics: Names to take.
        regex: Pattern of names to take, for the whole name; empty = none.
        exclude_topics: Names to leave out, whatever else says.
        exclude_regex: Pattern of names to leave out; empty = none.

    Raises:
        InputError: A pattern is no regular expression.
    """

    topics: tuple[str, ...] = ()
    regex: str = ""
    exclude_topics: tuple[str, ...] = ()
    exclude_regex: str = ""

    def __post_init__(self) -> None:
        for pattern in (self.regex, self.exclude_regex):
            try:
                re.compile(pattern)
            except (re.error, RecursionError, OverflowError) as error:
                raise InputError(
                    f"the pattern {pattern!r} was asked for; a regular expression is accepted "
                    f"({error})"
                ) from error

    def takes(self, name: str) -> bool:
        """Tells whether a topic is chosen."""
        if name in self.exclude_topics or _fits(self.exclude_regex, name):
            return False
        if not self.topics and not self.regex:
            return True
        return name in self.topics or _fits(self.regex, name)

    def require_known(self, names: Iterable[str]) -> None:
        """Refuses names that none of the topics has.

        Raises:
            InputError: A name to take is unknown.
        """
        known = list(names)
        for name in self.topics:
            if name not in known:
                raise InputError(
                    f"topic {name} was asked for; the bag has {', '.join(sorted(known))}"
                )


def _fits(pattern: str, name: str) -> bool:
    return bool(pattern) and re.fullmatch(pattern, name) is not None
