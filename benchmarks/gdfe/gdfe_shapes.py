# SPDX-License-Identifier: Apache-2.0
"""What shapes cost: processor time of gdfe_simulator's own code for a recorded session of the cell.

The session of tests/replay/bags/closings: start, a new friction model, three finger sets mounted, a swap check and a
closing with each. Messages go through the node's callbacks one after another, one thread, without middleware.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from pathlib import Path

import rclpy

from softgrip_bag.nodes.replayed_node import ReplayedNode
from softgrip_bag.reader import read
from softgrip_testing.benchmark_claim import claim, no_options, spread
from softgrip_time.units import to_s

BAG = Path(__file__).resolve().parents[2] / "tests" / "replay" / "bags" / "closings"
NODE = "softgrip_model.nodes.gdfe_simulator:GdfeSimulator"
RUNS = 3
INPUTS = {"/tendon/state", "/cell/state", "/friction/active"}


def session() -> tuple[float, float, int, float]:
    """Return processor time [s] of all and of the longest callback, shapes, and the session's length [s]."""
    began = time.process_time()
    node = ReplayedNode(NODE)
    total, longest, shapes = time.process_time() - began, 0.0, 0
    received = []
    for message in read(BAG, INPUTS):
        received.append(message.received)
        before = time.process_time()
        said = node.feed(message)
        spent = time.process_time() - before
        total, longest = total + spent, max(longest, spent)
        shapes += sum(output.topic == "/shape/predicted" for output in said)
    node.close()
    return total, longest, shapes, to_s(received[-1] - received[0])


def main() -> int:
    """Print the claims."""
    no_options(__doc__)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    rclpy.init(args=["--ros-args", "--log-level", "error"])
    runs = [session() for _ in range(RUNS)]
    rclpy.try_shutdown()
    totals, longest = [run[0] for run in runs], [run[1] for run in runs]
    what = f"{runs[0][2]} shapes in a session of {runs[0][3]:.0f} s"
    common = {"unit": "s", "better": "lower", "goal": None, "runs": RUNS}
    claim("shapes CPU of a session", statistics.median(totals), note=f"{what}; {spread(totals, 's')}", **common)
    claim("shapes longest callback", statistics.median(longest), note=spread(longest, "s"), **common)
    return 0


if __name__ == "__main__":
    sys.exit(main())
