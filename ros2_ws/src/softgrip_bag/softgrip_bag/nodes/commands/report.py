# SPDX-License-Identifier: Apache-2.0
"""Write a page about a bag: timeline, rates, latencies, friction fits, closings, grasps and faults."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from softgrip_bag import report
from softgrip_bag.errors import BagError
from softgrip_bag.nodes.digest import digest
from softgrip_bag.statistics import statistics


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: 0, or 2 when the bag cannot be read or the page not written."""
    parser = argparse.ArgumentParser(prog="ros2 run softgrip_bag report", description=__doc__)
    parser.add_argument("bag", type=Path, help="folder of the bag, or one .mcap file")
    parser.add_argument("-o", "--output", type=Path, help="file; default: BAG-report.html beside the bag")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object and write no page")
    options = parser.parse_args(args)
    path = options.output or options.bag.with_name(f"{options.bag.stem}-report.html")
    try:
        found, story = statistics(options.bag), digest(options.bag)
        if options.json:
            print(json.dumps(report.data(options.bag, found, story)))
        else:
            path.write_text(report.render(options.bag, found, story))
            print(path)
    except BagError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{path}: cannot be written: {error.strerror}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
