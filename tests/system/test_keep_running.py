# SPDX-License-Identifier: Apache-2.0
"""The launch prefix of every node: a refusal is passed on, a node that has worked comes back for ever."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from softgrip_testing.scripts import load_script

KEEPER = Path(__file__).resolve().parents[2] / "ros2_ws/src/softgrip_bringup/launch/keep_running.py"
#: Prints its process id, then waits to be ended.
NODE = ("/bin/sh", "-c", "echo $$; exec sleep 60")
#: Ends in another way at each start; at the fifth it works.
CRASHING = """
n=$(cat "$0" 2>/dev/null || echo 0); n=$((n + 1)); echo $n > "$0"
case $n in 1) kill -KILL $$;; 2) exit 1;; 3) exit 2;; 4) exit 0;; esac
echo works; exec sleep 60
"""


def keep_running() -> Any:
    return load_script(KEEPER)


def start(*command: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-IS", str(KEEPER), *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.parametrize("code", [0, 1, 2, 127])
def test_a_node_that_refuses_the_first_start_ends_the_keeper_with_its_code(code: int) -> None:
    with start("/bin/sh", "-c", f"exit {code}") as keeper:
        assert keeper.wait(20.0) == code


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


def test_a_node_that_has_worked_comes_back_however_it_ends(tmp_path: Path) -> None:
    with start("/bin/sh", "-c", CRASHING, str(tmp_path / "count")) as keeper:
        assert keeper.stdout is not None
        assert keeper.stderr is not None
        assert keeper.stdout.readline() == "works\n"
        said = [keeper.stderr.readline() for _ in range(4)]
        assert [line.removeprefix("[keep_running] the node ") for line in said] == [
            "was killed by SIGKILL; starting it again\n",
            "ended with exit code 1; starting it again in 2 s\n",
            "ended with exit code 2; starting it again in 4 s\n",
            "ended with exit code 0; starting it again in 8 s\n",
        ]
        keeper.send_signal(signal.SIGTERM)
        assert keeper.wait(20.0) == 128 + signal.SIGTERM


def test_a_signal_cuts_a_long_pause_short(tmp_path: Path) -> None:
    with start("/bin/sh", "-c", CRASHING, str(tmp_path / "count")) as keeper:
        assert keeper.stderr is not None
        while "in 8 s" not in keeper.stderr.readline():
            pass
        keeper.send_signal(signal.SIGTERM)
        assert keeper.wait(20.0) == 0
    assert (tmp_path / "count").read_text() == "4\n"


def test_crashes_never_end_it_and_pauses_grow_up_to_half_a_minute() -> None:
    restarts = keep_running().Restarts()
    assert restarts.pause_after(-signal.SIGSEGV, 0.1) == 1.0  # killed at once: not its own choice
    pauses = [restarts.pause_after(code, 0.1) for code in (1, 2, 0, -9, 127) * 200]
    assert pauses[:6] == [2.0, 4.0, 8.0, 16.0, 30.0, 30.0]
    assert set(pauses[5:]) == {30.0}
    assert restarts.pause_after(1, 60.0) == 1.0  # it has worked in between


@pytest.mark.parametrize(
    ("code", "lasted", "refused"),
    [(2, 0.5, True), (2, 60.0, True), (2, 121.0, False), (1, 9.0, True), (1, 11.0, False), (0, 1.0, True)],
)
def test_only_the_first_start_can_be_refused(code: int, lasted: float, refused: bool) -> None:
    restarts = keep_running().Restarts()
    assert (restarts.pause_after(code, lasted) is None) == refused


def test_a_refusal_ends_the_launch_where_that_is_asked_for() -> None:
    script = f"""
import signal, subprocess, sys
signal.signal(signal.SIGINT, lambda *_: print("interrupted", flush=True))
command = [sys.executable, "-IS", {str(KEEPER)!r}, *sys.argv[1:], "/bin/sh", "-c", "exit 2"]
print(subprocess.run(command, check=False).returncode)
"""
    for words, expected in ((["--end-launch-on-refusal"], ["interrupted", "2"]), ([], ["2"])):
        done = subprocess.run([sys.executable, "-c", script, *words], capture_output=True, text=True, check=True)
        assert done.stdout.split() == expected
