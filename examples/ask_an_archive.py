# SPDX-License-Identifier: Apache-2.0
"""Put bags into an archive and ask it in SQL."""

import sys
from pathlib import Path
from typing import Any

from softgrip_bag.archive import Archive, connect, shipped_queries
from softgrip_bag.archive.tables import story_tables
from softgrip_bag.nodes.digest import digest

BAGS = Path(__file__).parents[1] / "tests/replay/bags"


def main(folder: Path) -> list[tuple[Any, ...]]:
    """Return product, finger set, outcome and latency [s] of the grasps in a shipped bag."""
    archive = Archive(str(folder))
    added = archive.add(BAGS / "grasps", lambda bag, name: story_tables(bag, name, digest(bag)))
    print(f"{added.bag.name}: {added.state}, {added.rows} rows")
    ask = connect(archive)
    rows = ask.sql("SELECT product, finger_set, outcome, latency_s FROM grasps ORDER BY stamp").fetchall()
    for row in rows:
        print(*row)
    print("shipped questions:", ", ".join(shipped_queries()))
    return rows


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "archive"))
