# SPDX-License-Identifier: Apache-2.0
"""The emulated cell's fingers follow a filmed hand: joint error, and how long it takes from a frame to the tendon.

Starts the shipped cell on emulated hardware, mounts the power fingers and runs `teleoperate` on the film beside a pedal
that is pressed throughout. `follow error` is the root mean square, over fingers and frames, of the finger's true
deflection (emulator/truth) minus the hand's; the peer is a finger that never moves. `frame to tendon p95` is the cell's
time from a frame's stamp until the tendon is where the frame's order wants it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import rclpy
from _claim import claim
from _live_cell import SLOTS, START_S, cell
from numpy.typing import NDArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from softgrip_demo.nodes.hands import Hands
from softgrip_demo.nodes.link import CellLink
from softgrip_interfaces.msg import EmulatorTruth, TeleoperationState, TendonStatusArray
from softgrip_nodekit import RELIABLE, SENSOR, nanoseconds

Array = NDArray[np.float64]

FILM = Path("/work/shared/data/hand/human_hand_video.mp4")
DOMAIN = "58"
#: The pedal says so often that it is pressed [s].
PEDAL_S = 0.03
#: A tendon is where an order wants it within this [m]; orders that ask for less are not timed.
ARRIVED_M, MIN_ORDER_M = 0.0002, 0.0004
#: An order that is not reached within this was replaced by one that goes back [s].
MAX_ARRIVAL_S = 1.0


@dataclass
class Heard:
    """What the cell published meanwhile."""

    frames: list[TeleoperationState] = field(default_factory=list)
    truths: list[EmulatorTruth] = field(default_factory=list)
    states: list[JointState] = field(default_factory=list)


def listen(node: Node) -> Heard:
    """Collect what the cell says of hand, tendons and fingers."""
    heard = Heard()
    node.create_subscription(TeleoperationState, "teleoperation/state", heard.frames.append, RELIABLE)
    node.create_subscription(EmulatorTruth, "emulator/truth", heard.truths.append, SENSOR)
    node.create_subscription(JointState, "tendon/state", heard.states.append, SENSOR)
    return heard


def follow_film(film: Path, log: Path | None) -> tuple[Heard, float]:
    """Lead the fingers with a film; return what was heard, and how long it took by the wall clock [s]."""
    os.environ["ROS_DOMAIN_ID"] = DOMAIN
    with cell(DOMAIN, "record:=false", "panel:=false", "gripper:=false", log=log):
        rclpy.init()
        node = Node("teleoperation_benchmark", parameter_overrides=[Parameter("use_sim_time", value=True)])
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        hands = Hands()
        try:
            status: list[TendonStatusArray] = []
            node.create_subscription(TendonStatusArray, "tendon/status", status.append, SENSOR)
            link = CellLink(node, executor)
            link.until(lambda: bool(status), START_S, "tendon/status", Clock(clock_type=ClockType.STEADY_TIME))
            heard = listen(node)
            pedal = node.create_publisher(Bool, "teleoperation/dead_man", RELIABLE)
            command = [
                *(sys.executable, "-c", "from softgrip_design.nodes.teleoperate import main; raise SystemExit(main())"),
                *(str(film), "--home", "--profile", "power", "--max-tension", "20"),
            ]
            begun_s = time.monotonic()
            ended = threading.Event()
            with subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True) as process:
                threading.Thread(target=_press, args=(pedal, ended), daemon=True).start()
                while process.poll() is None:
                    executor.spin_once(timeout_sec=0.05)
            ended.set()
            if process.returncode:
                raise SystemExit(f"teleoperate ended with {process.returncode}")
            return heard, time.monotonic() - begun_s
        finally:
            hands.close()
            executor.shutdown(timeout_sec=2.0)
            node.destroy_node()
            rclpy.try_shutdown()


def _press(pedal: object, ended: threading.Event) -> None:
    while not ended.wait(PEDAL_S):
        pedal.publish(Bool(data=True))  # type: ignore[attr-defined]


def deflections(heard: Heard) -> tuple[Array, Array]:
    """Return the hand's and the fingers' deflections at the frames that moved something, (frames, slots) [rad]."""
    frames = [frame for frame in heard.frames if frame.duration > 0.0]
    times_s = np.array([1e-9 * nanoseconds(truth.header.stamp) for truth in heard.truths])
    order = [[one.finger for one in heard.truths[0].fingers].index(slot) for slot in SLOTS]
    sums = np.array([[sum(truth.fingers[k].joint_angles) for k in order] for truth in heard.truths])
    at_s = np.array([1e-9 * nanoseconds(frame.header.stamp) for frame in frames])
    finger = np.stack([np.interp(at_s, times_s, column) for column in sums.T], axis=1)
    hand = np.array([[frame.deflections[list(frame.tendons).index(slot)] for slot in SLOTS] for frame in frames])
    return hand, finger


def arrivals_s(heard: Heard) -> list[float]:
    """Return, for each order and tendon, how long after its frame the tendon was there by the cell's time [s]."""
    times_s = np.array([1e-9 * nanoseconds(state.header.stamp) for state in heard.states])
    found = []
    for frame in heard.frames:
        if frame.duration == 0.0:
            continue
        stamp_s = 1e-9 * nanoseconds(frame.header.stamp)
        window = slice(*np.searchsorted(times_s, [stamp_s, stamp_s + MAX_ARRIVAL_S]))
        for name, target_m in zip(frame.tendons, frame.targets, strict=True):
            lengths_m = np.array([state.position[list(state.name).index(name)] for state in heard.states[window]])
            if len(lengths_m) < 2 or abs(target_m - lengths_m[0]) < MIN_ORDER_M:
                continue
            towards = np.sign(target_m - lengths_m[0])
            there = np.flatnonzero(towards * (lengths_m - target_m) >= -ARRIVED_M)
            if there.size:
                found.append(float(times_s[window][there[0]] - stamp_s))
    return found


def main() -> None:
    """Measure and print the claims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("film", nargs="?", type=Path, default=FILM, help="of one hand, open first")
    parser.add_argument("--log", type=Path, help="of the cell's processes")
    parser.add_argument("--save", type=Path, metavar="NPZ", help="hand and finger deflections, for a plot")
    options = parser.parse_args()
    if not options.film.is_file():
        parser.error(f"expected a film of a hand at {options.film}, found none; name one")
    with tempfile.TemporaryDirectory() as folder:
        heard, wall_s = follow_film(options.film, options.log or Path(folder) / "log")
    hand, finger = deflections(heard)
    if options.save:
        np.savez(options.save, hand=hand, finger=finger)
    error_deg = np.degrees(np.sqrt(((finger - hand) ** 2).mean(axis=0)))
    still_deg = float(np.degrees(np.sqrt((hand**2).mean())))
    each = ", ".join(f"{slot} {error:.1f}" for slot, error in zip(SLOTS, error_deg, strict=True))
    times_s = np.array(arrivals_s(heard))
    cell_s = 1e-9 * (nanoseconds(heard.frames[-1].header.stamp) - nanoseconds(heard.frames[0].header.stamp))
    claim(
        "follow error", float(np.degrees(np.sqrt(((finger - hand) ** 2).mean()))), "deg", better="lower", goal=None,
        runs=len(hand), peer="fingers that do not move", peer_value=still_deg,
        note=f"root mean square of the sum of a finger's joints, true minus the hand's at the frame; {each} deg; delay "
        f"included; hand up to {np.degrees(hand.max()):.0f} deg",
    )  # fmt: skip
    claim(
        "frame to tendon p95", 1e3 * float(np.quantile(times_s, 0.95)), "ms", better="lower", goal=None,
        runs=len(times_s),
        note=f"the cell's time from a frame until its order is reached within 0.2 mm; median {1e3 * np.median(times_s):.0f} ms; "
        f"{len(heard.frames)} frames in {cell_s:.1f} s of the cell, {wall_s:.0f} s of the wall clock with homing",
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
