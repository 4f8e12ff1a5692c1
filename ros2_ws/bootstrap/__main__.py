"""Command line of the set-up: ``python -m bootstrap`` in ``ros2_ws``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from bootstrap.process import SetupError
from bootstrap.setup import run_setup


def main() -> int:
    """Set the work tree up and say in one sentence what is missing if that fails.

    Returns:
        Exit code: 0 ready, 1 failed, 130 interrupted.
    """
    parser = argparse.ArgumentParser(prog="make setup", description=__doc__)
    parser.add_argument(
        "--root", type=Path, default=Path(__file__).resolve().parents[2], help="the work tree"
    )
    try:
        run_setup(parser.parse_args().root.resolve())
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("setup: interrupted; run it again to go on", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
