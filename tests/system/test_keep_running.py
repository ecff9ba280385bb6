# SPDX-License-Identifier: Apache-2.0
"""The launch prefix of every node: a refusal is passed on, a killed node is started again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

KEEPER = Path(__file__).resolve().parents[2] / "ros2_ws/src/softgrip_bringup/launch/keep_running.py"
#: Prints its process id, then waits to be ended.
NODE = ("/bin/sh", "-c", "echo $$; exec sleep 60")


def start(*command: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-IS", str(KEEPER), *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.parametrize("code", [0, 2])
def test_a_node_that_ends_by_itself_ends_the_keeper_with_its_code(code: int) -> None:
    assert start("/bin/sh", "-c", f"exit {code}").wait(20.0) == code


def test_a_killed_node_is_started_again_and_a_signal_ends_both() -> None:
    with start(*NODE) as keeper:
        assert keeper.stdout is not None
        assert keeper.stderr is not None
        first = int(keeper.stdout.readline())
        os.kill(first, signal.SIGKILL)
        assert keeper.stderr.readline() == "[keep_running] the node was killed by SIGKILL; starting it again\n"
        second = int(keeper.stdout.readline())
        assert second != first
        keeper.send_signal(signal.SIGTERM)
        assert keeper.wait(20.0) == 128 + signal.SIGTERM
        with pytest.raises(ProcessLookupError):
            os.kill(second, 0)
