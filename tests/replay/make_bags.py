# SPDX-License-Identifier: Apache-2.0
"""Make the recorded bags of this folder anew: one session of the emulated cell, through the shipped launch file.

``python tests/replay/make_bags.py``, on a machine with nothing else to do. The excerpts carry what the replayed nodes
read and what they said. The grasps with every outcome come from a scripted bench: ``--bench --parts grasps``. After a
deliberate change of what a node computes ``--renew`` is enough: the recorded inputs stay, and the nodes answer them
anew.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import rounding

from softgrip_bag.mcap_file import Attachment
from softgrip_bag.nodes.messages import interface_text
from softgrip_bag.nodes.replay import renewed
from softgrip_bag.reader import RawMessage, read
from softgrip_testing.bag_excerpt import excerpt

HERE = Path(__file__).resolve().parent
BAGS = HERE / "bags"
LONGEST = 300.0  # [s] for a session
SECOND = 1_000_000_000
TENDONS = {"/tendon/state", "/cell/state", "/friction/active"}
FINGERS = TENDONS | {"/finger/measured", "/finger/predicted", "/finger/residual"}
CAMERA = "/camera/image_raw/compressed"


#: The folders of an absolute path, in a parameter file or after `sqlite:///`.
FOLDERS = re.compile(rb"(?:(?<=///)|(?<![\w/]))(?:/[\w.+-]+)+/(?=[\w.+-])")


@dataclass(frozen=True)
class Part:
    """An excerpt: its topics, and the stretch around the n-th message of one of them; none = all of the bag."""

    topics: set[str]
    around: str = ""
    count: int = 0
    before_s: float = 0.0
    after_s: float = 0.0


PARTS = {
    "calibration": Part({"/rig/sample", "/friction/active", "/rig/stage", "/load_cell/wrench"}),
    # every swap ends with a closing that the cell checks, and the session adds a longer one
    "closings": Part(FINGERS | {"/kinematics_predictor/input_notes"}),
    "shapes": Part(
        TENDONS | {"/shape/predicted", "/shape/marker", "/gdfe_simulator/input_notes"}, "/shape/predicted", 20, 0.3, 0.7
    ),
    # from the first frame on: a tracker remembers what it saw
    "frames": Part(
        {CAMERA, "/cell/state", "/finger/markers", "/finger/measured", "/marker_tracker/input_notes"},
        CAMERA,
        0,
        1.0,
        1.5,
    ),
    # from the start of the manager on: a grasp with each outcome, the last one by a fault
    "grasps": Part(
        FINGERS
        | {"/grasp_mix_manager/trace", "/tendon/status", "/diagnostics"}
        | {"/safety/state", "/tendon/owners", "/tendon/heartbeat"}
        | {
            f"/{action}/_action/{topic}"
            for action in ("cell/grasp", "cell/swap", "tendon/move")
            for topic in ("feedback", "status")
        }
    ),
}

#: Nodes whose answers `--renew` replaces; the manager's are steps that belong together, and are recorded only.
NODES = {"closings": "kinematics_predictor", "shapes": "gdfe_simulator", "frames": "marker_tracker"}


def main() -> int:
    """Record a session, or take a bag, and cut the excerpts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bag", type=Path, help="cut a bag that is there already")
    parser.add_argument("--bench", action="store_true", help="record the manager on the bench of test_manager_live.py")
    parser.add_argument("--seed", type=int, default=1, help="of the emulated cell")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=[*PARTS], help="only these")
    parser.add_argument("--renew", action="store_true", help="keep the recorded inputs")
    options = parser.parse_args()
    if options.renew:
        renewable = [name for name in options.parts if name in NODES]
        rounding.note(renewable)
        for name in renewable:
            renew(name)
        return 0
    rounding.note(options.parts)
    with tempfile.TemporaryDirectory(prefix="softgrip-replay-bags-") as folder:
        if options.bench:
            from test_manager_live import record as record_bench  # noqa: PLC0415  needs pytest

            bag = record_bench(Path(folder))
        else:
            bag = options.bag or record(Path(folder), options.seed)
        for name in options.parts:
            part = PARTS[name]
            shutil.rmtree(BAGS / name, ignore_errors=True)
            since, until = stretch(bag, part)
            count = excerpt(bag, BAGS / name, part.topics, since, until, edit=without_places)
            size = sum(file.stat().st_size for file in (BAGS / name).iterdir())
            sys.stdout.write(f"{name}: {count} messages, {size / 1e3:.0f} kB\n")
    return 0


def renew(name: str) -> None:
    """Have the node of a part answer its recorded inputs anew."""
    excerpt(BAGS / name, BAGS / f"{name}.new", instead=renewed(BAGS / name, NODES[name]), find=interface_text)
    shutil.rmtree(BAGS / name)
    excerpt(BAGS / f"{name}.new", BAGS / name, edit=without_places)
    shutil.rmtree(BAGS / f"{name}.new")


def without_places(attachment: Attachment) -> Attachment:
    """Take the folders of this computer out of a parameter file: a replay uses the attached files by their names."""
    return dataclasses.replace(attachment, data=FOLDERS.sub(b"/cell/", attachment.data))


def stretch(bag: Path, part: Part) -> tuple[int, int | None]:
    """Return beginning and end of a part [ns]; None = to the end."""
    if not part.around:
        return 0, None
    found: Iterator[RawMessage] = read(bag, {part.around})
    middle = next(message.received for number, message in enumerate(found) if number == part.count)
    return middle - round(part.before_s * SECOND), middle + round(part.after_s * SECOND)


def record(folder: Path, seed: int) -> Path:
    """Run a session; returns its bag."""
    with cell(folder, seed):
        subprocess.run([sys.executable, str(HERE / "session.py")], timeout=LONGEST, check=True)
    return next((folder / "bags").iterdir())


@contextmanager
def cell(folder: Path, seed: int) -> Iterator[None]:
    """Have the emulated cell run."""
    command = ["ros2", "launch", "softgrip_bringup", "cell.launch.yaml", f"out:={folder}", f"seed:={seed}"]
    command += [f"wire_dir:={folder / 'wires'}", "lift_window_s:=1.0"]
    with (folder / "log.txt").open("w") as log:
        launch = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
        try:
            yield
        finally:
            os.killpg(launch.pid, signal.SIGINT)
            launch.wait(LONGEST)


if __name__ == "__main__":
    sys.exit(main())
