# SPDX-License-Identifier: Apache-2.0
"""Finish a bag that was cut off, with everything in it that is intact."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from softgrip_bag.errors import BagError
from softgrip_bag.repair import is_broken, repair


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: 0 the bag is whole now, 2 it cannot be used."""
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_bag repair",
        description=__doc__,
        epilog="A bag that is whole is left as it is. A bag that is being recorded is refused.",
    )
    parser.add_argument("bag", type=Path, nargs="+", help="folder of a bag, or one .mcap file")
    options = parser.parse_args(args)
    code = 0
    for bag in options.bag:
        try:
            if bag.exists() and not is_broken(bag):
                print(f"{bag}: whole, nothing to do")
            else:
                print(repair(bag))
        except BagError as error:
            print(error, file=sys.stderr)
            code = 2
    return code


if __name__ == "__main__":
    sys.exit(main())
