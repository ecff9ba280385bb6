# SPDX-License-Identifier: Apache-2.0
"""A replay adds up as the nodes of a cell did: with one thread of OpenBLAS, told before numpy is imported."""

from __future__ import annotations

import os
import subprocess
import sys

WATCH = """
import os, sys
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            print(os.environ.get("OPENBLAS_NUM_THREADS"))
sys.meta_path.insert(0, Watch())
import softgrip_bag.nodes.commands.replay
"""


def test_numpy_of_a_replay_has_one_thread() -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    output = subprocess.run(
        [sys.executable, "-c", WATCH], capture_output=True, text=True, env=environment, check=True
    ).stdout
    assert output.split() == ["1"]
