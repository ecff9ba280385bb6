# SPDX-License-Identifier: Apache-2.0
"""Record every topic, with what the nodes were set up with, until Ctrl-C."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from softgrip_bag.nodes import recorder


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: the exit code of the recorder."""
    parser = argparse.ArgumentParser(
        prog="ros2 bag record",
        description=__doc__,
        epilog="What follows --ros-args goes to the node recorder; `ros2 param describe` explains its parameters.",
    )
    parser.add_argument("-a", "--all", action="store_true", help="all topics; so it is in any case")
    parser.add_argument("-o", "--output", default="", help="folder to create; default: one named by date and time")
    parser.add_argument("-d", "--max-bag-duration", type=float, default=0.0, metavar="S", help="seconds per file")
    parser.add_argument("-b", "--max-bag-size", type=int, default=0, metavar="MB", help="megabytes per file")
    given = list(sys.argv[1:] if args is None else args)
    at = given.index("--ros-args") if "--ros-args" in given else len(given)
    options = parser.parse_args(given[:at])
    values = {
        "root": ".",
        "path": options.output,
        "split_time_s": options.max_bag_duration,
        "split_size_mb": options.max_bag_size,
    }
    overrides = [word for name, value in values.items() if value != "" for word in ("-p", f"{name}:={value}")]
    return recorder.main(["record", "--ros-args", *overrides, *given[at + 1 :]])


if __name__ == "__main__":
    sys.exit(main())
