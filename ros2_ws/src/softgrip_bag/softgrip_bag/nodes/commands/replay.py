# SPDX-License-Identifier: Apache-2.0
"""Feed a bag through the real code of a node and compare every output with the recorded one."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

# the nodes of a cell have one thread of OpenBLAS (cell.launch.yaml): with more, its sums differ in their last bits.
# numpy reads it when it is imported
os.environ["OPENBLAS_NUM_THREADS"] = "1"

from softgrip_bag.errors import BagError
from softgrip_bag.nodes.replay import NODES, check


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: 0 identical, 1 a difference, 2 the bag or the node cannot be used."""
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_bag replay",
        description=__doc__,
        epilog="Exit code 0: identical; 1: a difference, the first one is printed; 2: bag or node cannot be used.",
    )
    parser.add_argument("bag", type=Path, help="folder of the bag, or one .mcap file")
    parser.add_argument("--through", choices=sorted(NODES), required=True, help="node to feed")
    parser.add_argument("--check", action="store_true", help=argparse.SUPPRESS)  # former; a replay always compares
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--tolerance", type=float, default=0.0, help="relative, for a bag of another machine; 0 = exact"
    )
    options, ros_arguments = parser.parse_known_args(args)
    if ros_arguments and ros_arguments[0] != "--ros-args":
        parser.error(f"expected one bag, and --ros-args before arguments of the node, found {' '.join(ros_arguments)}")
    try:
        result = check(
            options.bag, options.through, [a for a in ros_arguments if a != "--ros-args"], tolerance=options.tolerance
        )
    except BagError as error:
        print(error, file=sys.stderr)
        return 2
    detail = str(result.divergence) if result.divergence else ""
    if result.divergence and result.without_input:
        detail += f"; before that, inputs of {result.without_input} outputs are missing in the bag"
    if options.json:
        values = {"compared": result.compared, "identical": result.identical, "detail": detail}
        print(json.dumps(values | {"without_input": result.without_input}))
    elif result.identical:
        alike = f"equal within {options.tolerance:g}" if options.tolerance else "identical"
        print(f"{result.compared} outputs of {options.through} compared: {alike}")
    else:
        print(detail or f"expected outputs of {options.through} in the bag, found none to compare")
    if result.without_input and not options.json:
        print(f"{result.without_input} outputs not compared: the bag lacks their input (see `ros2 bag info`)")
    return 0 if result.identical else 1


if __name__ == "__main__":
    sys.exit(main())
