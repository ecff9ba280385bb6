# SPDX-License-Identifier: Apache-2.0
"""Run one shift of the emulated cell and its report: what `make demo` does.

The log of all processes goes to OUT/log.txt; the terminal shows the shift itself and whatever went wrong.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import timeit
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

#: `capacity` that a shift at full pace needs, and the share of their time that the processors may be away.
FULL_PACE = 4.0
AWAY = 0.1
#: [s] how long that is looked at, on at most so many processors, and what counts as away.
LOOK = 0.7
LOOKED_AT = 4
GAP = 0.001

#: The log of all processes; a folder that holds one is an earlier shift's and may be emptied.
LOG = "log.txt"

#: Lines of the log that the terminal shows: the shift's own, and why a process ended.
SHOWN = re.compile(
    r"^\[shift-\d+\] (?:\[INFO\] \[[\d.]+\] \[shift\]: )?(?P<said>.*)|(?P<bad>.*(?:cannot start:|process has died).*)"
)


def main() -> int:
    """Run the launch file, then the report; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for record, bag and report; an earlier shift's is emptied first")
    parser.add_argument("--seed", type=int, default=1, help="seed of the emulated cell")
    parser.add_argument("--cross-check", action="store_true", help="grasp every product with every finger set")
    parser.add_argument(
        "--pace",
        choices=["auto", "full", "half"],
        default="auto",
        help="half: camera at 12 frames/s, rig at 20 instead of 60 times its speed, fingers half as fast; "
        "auto: full where this computer is fast and free enough for the emulated cell in real time",
    )
    parser.add_argument(
        "launch_arguments",
        nargs="*",
        metavar="NAME:=VALUE",
        help="of demo.launch.yaml: camera_fps:=30.0 frames_priority:=10 for frames that come soon",
    )
    arguments = parser.parse_intermixed_args()
    if shutil.which("ros2") is None:
        print(
            "expected `ros2` on the PATH, found none: use `make demo`, or source the workspace first", file=sys.stderr
        )
        return 2
    if arguments.pace == "auto":
        arguments.pace = pace(capacity(), away())
        if arguments.pace == "half":
            print(
                "this computer is too slow or too busy for the emulated cell in real time: the shift goes at half pace"
            )
    if arguments.out.is_dir() and any(arguments.out.iterdir()) and not (arguments.out / LOG).exists():
        print(f"{arguments.out} holds files of something else; name a new or empty folder", file=sys.stderr)
        return 2
    if arguments.out.exists():
        shutil.rmtree(arguments.out)
    arguments.out.mkdir(parents=True)
    code = run_cell(arguments)
    if code != 0 or not (arguments.out / "shift.json").exists():
        print(
            f"The shift did not reach its end (exit code {code}); the log is {arguments.out / LOG}",
            file=sys.stderr,
        )
        return code or 1
    return subprocess.run(["ros2", "run", "softgrip_demo", "report", str(arguments.out)], check=False).returncode


def pace(steps: float, lost: float) -> str:
    """Return the pace at which a shift is sound where the processors do so many `steps` and so much time is `lost`."""
    return "full" if steps >= FULL_PACE and lost <= AWAY else "half"


def capacity() -> float:
    """Return what the processors of this computer do together: steps of a plain loop [1/s], in 1e7."""
    seconds = min(timeit.repeat("for i in range(1000000): total += i", "total = 0", number=1, repeat=5))
    return (os.cpu_count() or 1) * 0.1 / seconds


def away() -> float:
    """Return the share of time in which this computer's processors work for somebody else while all are wanted."""
    workers = min(os.cpu_count() or 1, LOOKED_AT)
    with ProcessPoolExecutor(workers) as pool:
        return sum(pool.map(lost, [LOOK] * workers)) / (workers * LOOK)


def lost(duration: float, clock: Callable[[], float] = time.perf_counter) -> float:
    """Work without a pause; return the sum of the gaps in it [s]."""
    last = clock()
    end = last + duration
    gaps = 0.0
    while last < end:
        now = clock()
        gaps += now - last if now - last > GAP else 0.0
        last = now
    return gaps


def run_cell(arguments: argparse.Namespace) -> int:
    """Run the demo's launch file to its end; Ctrl-C ends all of its processes before this returns."""
    command = ["ros2", "launch", "softgrip_bringup", "demo.launch.yaml"]
    command += [
        f"out:={arguments.out}",
        f"seed:={arguments.seed}",
        f"pace:={arguments.pace}",
        f"cross_check:={str(arguments.cross_check).lower()}",
        *arguments.launch_arguments,
    ]
    with (
        (arguments.out / LOG).open("w") as log,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as launch,
    ):
        signal.signal(signal.SIGTERM, lambda *_: launch.send_signal(signal.SIGINT))
        assert launch.stdout is not None
        while True:
            try:
                for line in launch.stdout:
                    log.write(line)
                    log.flush()
                    match = SHOWN.match(line)
                    if match:
                        print((match["said"] or match["bad"]).rstrip(), flush=True)
                return launch.wait()
            except KeyboardInterrupt:
                launch.send_signal(signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
