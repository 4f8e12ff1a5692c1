"""Which DDS domain a graph gets. Needs no ROS."""

import os
from pathlib import Path


def domain_of_graph(environment: dict[str, str], locks: Path = Path("/proc/net/udp")) -> int:
    """Returns the DDS domain of a new graph: the one asked for, else 0 if unused, else a free one.

    Args:
        environment: Environment variables; ``ROS_DOMAIN_ID`` decides when it is set.
        locks: The kernel's table of UDP sockets.
    """
    asked = environment.get("ROS_DOMAIN_ID", "").strip()
    if asked:
        return int(asked)
    used = _udp_ports(locks)
    first = os.getpid() % 100
    for domain in (0, *(1 + (first + i) % 100 for i in range(100))):
        # DDS: each domain has 250 ports from 7400 on.
        if not any(7400 + 250 * domain <= port < 7650 + 250 * domain for port in used):
            return domain
    return 0


def _udp_ports(table: Path) -> set[int]:
    try:
        lines = table.read_text(encoding="ascii").splitlines()[1:]
    except OSError:
        return set()
    return {int(line.split()[1].rsplit(":", 1)[1], 16) for line in lines if line.strip()}
