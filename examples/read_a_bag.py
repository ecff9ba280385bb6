# SPDX-License-Identifier: Apache-2.0
"""Read a bag without ROS: how hard was each tendon pulled?"""

import sys
from pathlib import Path

from softgrip_bag.definition import decode, parse_definitions
from softgrip_bag.reader import read, topic_summaries

BAG = Path(__file__).parents[1] / "tests/replay/bags/grasps"
TOPIC = "/tendon/state"


def main(bag: Path = BAG) -> dict[str, float]:
    """Return tendon -> largest tension [N]."""
    topics = {topic.name: topic for topic in topic_summaries(bag)}
    for topic in topics.values():
        print(f"{topic.messages:6d}  {topic.name:32} {topic.type_name}")
    kind = topics[TOPIC]
    definitions = parse_definitions(kind.type_name, kind.schema)  # the bag carries its own
    largest: dict[str, float] = {}
    for raw in read(bag, {TOPIC}):
        state = decode(kind.type_name, definitions, raw.data).values
        for name, tension in zip(state["name"], state["effort"], strict=True):
            largest[name] = max(largest.get(name, 0.0), tension)
    print("largest tension: " + ", ".join(f"{name} {tension:.1f} N" for name, tension in largest.items()))
    return largest


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
