# SPDX-License-Identifier: Apache-2.0
"""What a cell costs while nobody asks it for anything: processor share and memory of each process.

The shipped launch file on emulated hardware: the drives' loop, the camera and the tracker run, nothing is grasped. The
emulated hardware is a process of its own and is left out of the sums: a real cell has none. Shares are of the cell's
time, which on a busy computer waits for its nodes: so they say what a second of the cell costs. Python's files are
compiled beforehand, as after a first start: compiling them leaves megabytes behind in each process. Linux only (/proc).

"Idles under 15 % of one core" is read both ways: "idle cell CPU" is that of all processes together, "idle cell CPU of
the busiest node" that of each process.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from _live_cell import START_S, cell, cell_time_s

from softgrip_testing.benchmark_claim import claim, no_options, spread
from softgrip_testing.process_table import node_processes, processor_s, resident_bytes

RUNS = 3
SETTLE_S = 20.0
MEASURE_S = 10.0
DOMAIN = "78"
EMULATOR = "emulated_cell"
NODES = (
    EMULATOR, "recorder", "tendon_driver", "friction_rig", "kinematics_predictor", "gdfe_simulator", "camera",
    "marker_tracker", "grasp_mix_manager", "gripper_command", "hand_description", "panel",
)  # fmt: skip
ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Cost:
    """Of one process."""

    cpu_percent: float
    rss_mb: float


def measure(processes: dict[str, int], now_s: Callable[[], float]) -> dict[str, Cost]:
    """Return what each process costs over `MEASURE_S` of the cell's time."""
    begin = now_s()
    before = {name: processor_s(process) for name, process in processes.items()}
    while now_s() < begin + MEASURE_S:
        time.sleep(0.5)
    seconds = now_s() - begin
    return {
        name: Cost(100.0 * (processor_s(process) - before[name]) / seconds, resident_bytes(process) / 1e6)
        for name, process in processes.items()
    }


def compile_sources() -> dict[str, str]:
    """Compile the suite's Python files; return the environment in which they are used so."""
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": ""}
    folders = [str(ROOT / "embedded"), str(ROOT / "ros2_ws" / "src")]
    subprocess.run([sys.executable, "-m", "compileall", "-q", *folders], env=environment, check=True)
    return environment


def _settle(launch: subprocess.Popen[bytes], deadline: float) -> None:
    """Wait until the time server is up, and `SETTLE_S` of the cell's time more."""
    while True:
        try:
            begin = cell_time_s(launch)
            break
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)
    while cell_time_s(launch) < begin + SETTLE_S:
        time.sleep(0.5)


def run_cell() -> list[dict[str, Cost]]:
    """Start a cell, let it settle, measure it several times."""
    with cell(DOMAIN, environment=compile_sources()) as launch:
        deadline = time.monotonic() + START_S
        while not set(NODES) <= (processes := node_processes(launch.pid)).keys():
            if time.monotonic() > deadline or launch.poll() is not None:
                missing = ", ".join(set(NODES) - processes.keys())
                raise RuntimeError(f"the cell did not start; missing: {missing}")
            time.sleep(0.1)
        _settle(launch, deadline)
        measured = {name: processes[name] for name in NODES}
        return [measure(measured, lambda: cell_time_s(launch)) for _ in range(RUNS)]


def main() -> None:
    """Measure and print the claims."""
    no_options(__doc__)
    runs = run_cell()
    nodes = [{name: cost for name, cost in run.items() if name != EMULATOR} for run in runs]
    median = {
        name: Cost(
            statistics.median(run[name].cpu_percent for run in runs),
            statistics.median(run[name].rss_mb for run in runs),
        )
        for name in NODES
    }
    each = "; ".join(f"{name} {cost.cpu_percent:.0f} % {cost.rss_mb:.0f} MB" for name, cost in median.items())
    figures = (
        ("idle cell CPU", "%", 15.0, [sum(cost.cpu_percent for cost in run.values()) for run in nodes]),
        ("idle cell CPU of the busiest node", "%", 15.0, [max(c.cpu_percent for c in run.values()) for run in nodes]),
        ("idle cell largest RSS", "MB", 80.0, [max(cost.rss_mb for cost in run.values()) for run in nodes]),
    )
    for name, unit, goal, values in figures:
        note = f"{spread(values, unit)}; {each}"
        claim(name, statistics.median(values), unit, better="lower", goal=goal, runs=RUNS, note=note)


if __name__ == "__main__":
    main()
