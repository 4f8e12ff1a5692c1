"""ROS domains that no other test process on this machine has."""

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

# Above 101 the ports of a domain may collide with those that the system hands out to anybody.
_FIRST, _COUNT = 40, 62


class _Domains:
    """Hands out domains in turn, so that each is used again as late as possible.

    DDS takes a process that was killed for one that runs, for up to 20 s.
    """

    def __init__(self) -> None:
        self._folder = Path(tempfile.gettempdir()) / f"skinplan-test-domains-{os.getuid()}"
        # Two processes that were started one after the other begin far from each other.
        self._next = 31 * os.getpid() + os.getpid() // 2

    def claim(self) -> tuple[int, IO[str]]:
        """Returns a domain, and the file whose closing gives it back."""
        self._folder.mkdir(exist_ok=True)
        for _ in range(_COUNT):
            domain = _FIRST + self._next % _COUNT
            self._next += 1
            handle = (self._folder / str(domain)).open("w")
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                handle.close()
                continue
            return domain, handle
        raise RuntimeError(
            f"all {_COUNT} ROS domains for tests are taken: are test processes left over?"
        )


_DOMAINS = _Domains()


@contextmanager
def own_domain() -> Iterator[int]:
    """Makes a domain that nobody has the one of all contexts and processes that begin inside."""
    domain, handle = _DOMAINS.claim()
    before = os.environ.get("ROS_DOMAIN_ID")
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    try:
        yield domain
    finally:
        if before is None:
            del os.environ["ROS_DOMAIN_ID"]
        else:
            os.environ["ROS_DOMAIN_ID"] = before
        handle.close()
