# SPDX-License-Identifier: Apache-2.0
"""Print what a bag holds: topics, rates, how it was set up, and what is missing from it."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from softgrip_bag.errors import BagError
from softgrip_bag.reader import attachments, bag_files, facts
from softgrip_bag.repair import is_broken
from softgrip_bag.statistics import BagStatistics, statistics
from softgrip_time.units import to_s


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: 0, or 2 when the bag cannot be read."""
    parser = argparse.ArgumentParser(prog="ros2 bag info", description=__doc__)
    parser.add_argument("bag", type=Path, help="folder of the bag, or one .mcap file")
    options = parser.parse_args(args)
    if args is None:
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `info BAG | head` ends as other commands do
    try:
        print(text(options.bag, statistics(options.bag)))
    except BagError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def text(bag: Path, found: BagStatistics) -> str:
    """Return the listing."""
    size, count = sum(file.stat().st_size for file in bag_files(bag)), len(bag_files(bag))
    lines = [
        f"Bag:       {bag}, {count} file{'s' * (count != 1)}, {size / 1e6:.1f} MB"
        + (", was cut off: `ros2 run softgrip_bag repair` finishes it" if is_broken(bag) else ""),
        f"Start:     {datetime.fromtimestamp(to_s(found.start), UTC).isoformat()}",
        f"Duration:  {found.duration:.3f} s",
        f"Messages:  {found.messages}",
        f"Carried:   {', '.join(a.name for a in attachments(bag)) or 'nothing'}",
        *(line for name, values in facts(bag).items() if name != "rosbag2" for line in _fact_lines(name, values)),
        "Topics:",
    ]
    width = max((len(topic.name) for topic in found.topics), default=0)
    for topic in found.topics:
        rate = f"{topic.rate:7.1f} Hz, longest gap {topic.longest_gap:.3f} s" if topic.messages > 1 else ""
        lines.append(f"  {topic.name:{width}}  {topic.type_name:45} {topic.messages:7}  {rate}".rstrip())
    return "\n".join(lines)


def _fact_lines(name: str, values: Mapping[str, str]) -> Iterator[str]:
    """Yield a name, and below it one line a value; of a value of many lines the first and their number."""
    yield f"{name}:"
    for key, value in values.items():
        first, *rest = value.splitlines() or [""]
        yield f"  {key}: {first.strip()}" + (f" (and {len(rest)} more)" if rest else "")


if __name__ == "__main__":
    sys.exit(main())
