# SPDX-License-Identifier: Apache-2.0
"""Run one shift of the emulated cell and its report: what `make demo` does.

The log of all processes goes to OUT/log.txt; the terminal shows the shift itself and whatever went wrong.
"""

from __future__ import annotations

import argparse
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

#: The log of all processes; a folder that holds one is an earlier shift's and may be emptied.
LOG = "log.txt"

#: Lines of the log that the terminal shows: the shift's own, and why a process ended.
SHOWN = re.compile(
    r"^\[shift-\d+\] (?:\[INFO\] \[[\d.]+\] \[shift\]: )?(?P<said>.*)"
    r"|.*(?P<page>the page is at http.*)|(?P<bad>.*(?:cannot start:|process has died).*)"
)


def main() -> int:
    """Run the launch file, then the report; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for record, bag and report; an earlier shift's is emptied first")
    parser.add_argument("--seed", type=int, default=1, help="seed of the emulated cell")
    parser.add_argument("--cross-check", action="store_true", help="grasp every product with every finger set")
    parser.add_argument(
        "launch_arguments",
        nargs="*",
        metavar="NAME:=VALUE",
        help="of demo.launch.yaml: speed:=1.0 for real time, camera_fps:=30.0 for more frames",
    )
    arguments = parser.parse_intermixed_args()
    if shutil.which("ros2") is None:
        print(
            "expected `ros2` on the PATH, found none: use `make demo`, or source the workspace first", file=sys.stderr
        )
        return 2
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


def run_cell(arguments: argparse.Namespace) -> int:
    """Run the demo's launch file to its end; Ctrl-C ends all of its processes before this returns."""
    command = ["ros2", "launch", "softgrip_bringup", "demo.launch.yaml"]
    command += [
        f"out:={arguments.out}",
        f"seed:={arguments.seed}",
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
                        print((match["bad"] or match["page"] or match["said"]).rstrip(), flush=True)
                return launch.wait()
            except KeyboardInterrupt:
                launch.send_signal(signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
