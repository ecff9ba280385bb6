# SPDX-License-Identifier: Apache-2.0
"""The emulated cell's fingers follow a filmed hand: joint error, and how long it takes from a frame to the tendon.

Starts the shipped cell on emulated hardware, mounts the power fingers and runs `teleoperate` on the film, beside a
pedal that is pressed once the open hand has been seen. `joint error` is the root mean square, over joints and
frames, of the finger's true angle (emulator/truth) minus the hand's; the peer is a finger that never moves. `frame to
tendon p95` is the cell's time from a frame's stamp until the tendon is where the frame's order wants it.
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
from _live_cell import SLOTS, cell
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
from softgrip_nodekit import RELIABLE, SENSOR, seconds
from softgrip_testing.benchmark_claim import claim

Array = NDArray[np.float64]

#: A film of a hand; docs/design.md says where the one that was measured comes from.
FILM = os.environ.get("SOFTGRIP_HAND_VIDEO", "")
DOMAIN = "58"
#: A cell on a busy machine is up within this [s].
START_S = 180.0
#: The pedal says so often that it is pressed [s].
PEDAL_S = 0.03
#: A tendon is where an order wants it within this [m]; orders that ask for less are not timed.
ARRIVED_M, MIN_ORDER_M = 0.0002, 0.0004
#: A hand is still when its fingers' joints add up to the same within this [rad] for so long [s].
STILL_RAD, STILL_S = np.radians(5.0), 0.4
#: Further than this the fingers do not close with 20 N [rad].
REACH_RAD = np.radians(150.0)
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
                threading.Thread(target=_press, args=(pedal, heard, ended), daemon=True).start()
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


def _press(pedal: object, heard: Heard, ended: threading.Event) -> None:
    """Press once the open hand has been seen, as a person would."""
    while not ended.wait(PEDAL_S):
        if heard.frames and "open hand" not in heard.frames[-1].reason:
            pedal.publish(Bool(data=True))  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Followed:
    """Hand and fingers at the frames that moved something, joints finger by finger.

    Attributes:
        times_s: (frames,) of the cell.
        hand, finger: (frames, joints) [rad].
        slot: (joints,) whose joint it is.
    """

    times_s: Array
    hand: Array
    finger: Array
    slot: tuple[str, ...]

    def sums(self, angles: Array) -> Array:
        """Return the deflections of the fingers, (frames, slots) [rad]."""
        return np.stack([angles[:, [one == slot for one in self.slot]].sum(axis=1) for slot in SLOTS], axis=1)


def followed(heard: Heard) -> Followed:
    """Return what the hand showed and what the fingers truly did at the same time."""
    frames = [frame for frame in heard.frames if frame.duration > 0.0]
    tendons = list(frames[0].tendons)
    truth_s = np.array([seconds(truth.header.stamp) for truth in heard.truths])
    fingers = [next(one for one in heard.truths[0].fingers if one.finger == slot) for slot in tendons]
    slot = tuple(one.finger for one in fingers for _ in one.joint_angles)
    true = np.array(
        [
            [angle for slot in tendons for one in truth.fingers if one.finger == slot for angle in one.joint_angles]
            for truth in heard.truths
        ]
    )
    at_s = np.array([seconds(frame.header.stamp) for frame in frames])
    finger = np.stack([np.interp(at_s, truth_s, column) for column in true.T], axis=1)
    return Followed(at_s, np.array([frame.joint_angles for frame in frames]), finger, slot)


def is_still(one: Followed) -> Array:
    """Return where the hand is still, within what the fingers reach, (frames, slots)."""
    sums = one.sums(one.hand)
    first = np.searchsorted(one.times_s, one.times_s - STILL_S)
    moved = np.array([np.ptp(sums[a : k + 1], axis=0) for k, a in enumerate(first)])
    return (moved < STILL_RAD) & (sums < REACH_RAD) & (one.times_s[:, None] - one.times_s[0] > STILL_S)


def arrivals_s(heard: Heard) -> list[float]:
    """Return, for each order and tendon, how long after its frame the tendon was there by the cell's time [s]."""
    times_s = np.array([seconds(state.header.stamp) for state in heard.states])
    found = []
    for frame in heard.frames:
        if frame.duration == 0.0:
            continue
        stamp_s = seconds(frame.header.stamp)
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


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Measure and print the claims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "film",
        nargs="?",
        type=Path,
        default=FILM or None,
        help="of one hand, open first; default: $SOFTGRIP_HAND_VIDEO",
    )
    parser.add_argument("--log", type=Path, help="of the cell's processes")
    parser.add_argument("--save", type=Path, metavar="NPZ", help="hand and finger deflections, for a plot")
    options = parser.parse_args()
    if options.film is None or not options.film.is_file():
        parser.error(f"expected a film of a hand, found {options.film}; name one, or set SOFTGRIP_HAND_VIDEO")
    with tempfile.TemporaryDirectory() as folder:
        heard, elapsed_s = follow_film(options.film, options.log or Path(folder) / "log")
    found = followed(heard)
    if options.save:
        np.savez(options.save, times_s=found.times_s, hand=found.hand, finger=found.finger, slot=found.slot)
    joints_deg = np.degrees(found.finger - np.maximum(found.hand, 0.0))
    hand, finger = found.sums(found.hand), found.sums(found.finger)
    sums_deg = np.degrees(finger - np.maximum(hand, 0.0))
    each = ", ".join(f"{slot} {rms(column):.1f}" for slot, column in zip(SLOTS, sums_deg.T, strict=True))
    times_s = np.array(arrivals_s(heard))
    cell_s = seconds(heard.frames[-1].header.stamp) - seconds(heard.frames[0].header.stamp)
    claim(
        "joint error", rms(joints_deg), "deg", better="lower", goal=None, runs=len(hand),
        peer="fingers that do not move", peer_value=rms(np.degrees(found.hand)),
        note=f"root mean square over joints and frames, with the delay; of a finger's sum {rms(sums_deg):.1f} "
        f"deg ({each}), of a still hand within reach {rms(sums_deg[is_still(found)]):.1f} deg; hand up to "
        f"{np.degrees(hand.max()):.0f} deg",
    )  # fmt: skip
    claim(
        "frame to tendon p95", 1e3 * float(np.quantile(times_s, 0.95)), "ms", better="lower", goal=None,
        runs=len(times_s),
        note="the cell's time from a frame until its order is reached within 0.2 mm; median "
        f"{1e3 * np.median(times_s):.0f} ms; {len(heard.frames)} frames in {cell_s:.1f} s of the cell, {elapsed_s:.0f} "
        "s of the wall clock with homing",
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
