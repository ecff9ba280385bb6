# SPDX-License-Identifier: Apache-2.0
"""At which pace `make demo` goes: by what the processors do, and by how long they are away."""

import importlib.util
import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

TOOL = Path(__file__).parents[2] / "tools" / "demo.py"


@pytest.fixture(scope="module")
def demo():
    spec = importlib.util.spec_from_file_location("softgrip_demo_tool", TOOL)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def ticks(*pauses, step=1e-5):
    """A clock read again and again by one who works, and who is away for each of the pauses [s] in turn."""
    now = 0.0
    for number in itertools.count(1):
        yield now
        now += step
        if number % 1000 == 0 and number // 1000 <= len(pauses):
            now += pauses[number // 1000 - 1]


@pytest.mark.parametrize(
    ("pauses", "gaps"),
    [((), 0.0), ((0.0005, 0.0005), 0.0), ((0.020,), 0.020), ((0.020, 0.0005, 0.010), 0.030)],
    ids=["none", "short ones", "one", "two and a short one"],
)
def test_what_is_lost_is_the_sum_of_the_long_gaps(demo, pauses, gaps):
    clock = ticks(*pauses)
    assert demo.lost(0.7, clock=lambda: next(clock)) == pytest.approx(gaps, abs=1e-4)


def work(demo_path, answers):
    spec = importlib.util.spec_from_file_location("softgrip_demo_tool", demo_path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    answers.send("ready")
    answers.send(module.lost(0.5))


def test_a_process_that_was_stopped_has_lost_that_time(demo):
    """A stopped process is to its own clock what a processor is that works for somebody else."""
    here, there = multiprocessing.get_context("spawn").Pipe()
    worker = multiprocessing.get_context("spawn").Process(target=work, args=(TOOL, there))
    worker.start()
    assert here.poll(30.0)
    assert here.recv() == "ready"
    time.sleep(0.1)
    os.kill(worker.pid, signal.SIGSTOP)
    time.sleep(0.2)
    os.kill(worker.pid, signal.SIGCONT)
    assert here.poll(30.0)
    assert here.recv() >= 0.19
    worker.join(10.0)


@pytest.mark.parametrize(
    ("steps", "lost", "pace"),
    [(9.0, 0.0, "full"), (4.0, 0.1, "full"), (3.9, 0.0, "half"), (9.0, 0.11, "half"), (1.0, 0.5, "half")],
)
def test_full_pace_needs_processors_that_are_fast_and_there(demo, steps, lost, pace):
    assert demo.pace(steps, lost) == pace


def test_launch_arguments_may_come_last_and_a_missing_ros2_is_named(tmp_path: Path) -> None:
    command = [sys.executable, TOOL, tmp_path / "out", "--seed", "1", "camera_fps:=30.0", "frames_priority:=10"]
    nothing = {**os.environ, "PATH": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, env=nothing, timeout=60, check=False)
    assert done.returncode == 2
    assert "expected `ros2` on the PATH, found none" in done.stderr
    assert not (tmp_path / "out").exists()
