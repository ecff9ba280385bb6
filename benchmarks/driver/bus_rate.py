# SPDX-License-Identifier: Apache-2.0
"""The servo bus: four servos at 3 Mbaud, emulated with true byte timing in a process of their own.

Ours is the driver's whole control loop as fast as it goes (group read, controller, group write, one slow item); the
peer is a bare dynamixel-sdk GroupSyncRead of the same bytes with a GroupSyncWrite, in the same run. Jitter and CPU
share are measured at a fixed 250 Hz; a silent servo is one whose ID nobody has. Where the system allows it, loop, peer
and emulator run at real-time priority, the driver's default; servos are never scheduled away.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import dynamixel_sdk

from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration as DriverServo
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import ID, MODELS, PRESENT_CURRENT
from softgrip_driver.tendon.gripper import GripperController, MoveMode, MoveRequest, Policies
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.loop import BusLoop
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_emulator.dynamixel.table import load_model
from softgrip_emulator.wire.pty import PtyPort
from softgrip_nodekit import claim_processor
from softgrip_testing.benchmark_claim import claim, no_options, spread

BAUD = 3_000_000
SERVOS = 4
RUNS = 5
SECONDS = 2.0
FIXED_RATE = 250.0
PRIORITY, EMULATOR_PRIORITY = 20, 30
#: [Hz] that no loop here reaches: the loop runs as fast as it can
FLAT_OUT = 3000.0


def emulate(link: str, stop: multiprocessing.connection.Connection) -> None:
    """Serve the chain until told to stop; the shafts stand still, so that only the bus is measured."""
    claim_processor(EMULATOR_PRIORITY)
    model = load_model("xl330_m288")
    servos = [EmulatedServo(model, number, baud=BAUD, return_delay_us=0) for number in range(1, SERVOS + 1)]
    with PtyPort(Path(link), DynamixelChain(servos)):
        stop.send("ready")
        stop.recv()


@contextmanager
def emulated_bus() -> Iterator[str]:
    """A bus in a process of its own; gives its path."""
    ours, theirs = multiprocessing.Pipe()
    with tempfile.TemporaryDirectory() as folder:
        link = str(Path(folder) / "servos")
        process = multiprocessing.get_context("spawn").Process(target=emulate, args=(link, theirs), daemon=True)
        process.start()
        ours.recv()
        try:
            yield link
        finally:
            ours.send("stop")
            process.join(5.0)


def run_driver(link: str, rate: float, *, silent: bool = False) -> tuple[float, float, float]:
    """Run the driver's loop; return (rate [Hz], p99 of |period - nominal| [s], share of one core)."""
    model = MODELS["XL330-M288"]
    torque = TorqueModel(model.torque_per_ampere, model.no_load_current)
    servos = [DriverServo(f"t{i}", i, model, Spool(0.01, 1), torque) for i in range(1, SERVOS + 1)]
    backend = DynamixelBackend(Bus(link, BAUD, reply_margin=0.004), servos, watchdog=0.0)
    backend.connect()
    # The silent servo's emulator is told another ID: nobody answers to its own.
    if silent:
        backend.bus.write(SERVOS, ID, 99)
    limits = TendonLimits()
    controller = GripperController({servo.tendon: limits for servo in servos}, Policies())
    loop = BusLoop(backend, controller, rate, history=int(FLAT_OUT * SECONDS * 2))
    try:
        with ThreadPoolExecutor(1, initializer=claim_processor, initargs=(PRIORITY,)) as thread:
            thread.submit(loop.start).result()  # its thread inherits the priority
        answering = SERVOS - 1 if silent else SERVOS
        assert loop.wait_for(lambda seen: sum(d.time > 0.0 for d in seen.drives) == answering, 3.0) is not None
        loop.power(on=True)
        for servo in servos[:answering]:
            loop.call(lambda c, _, t=servo.tendon: c.drives[t].set_zero(c.drives[t].position, 0))
        names = [servo.tendon for servo in servos[:answering]]
        loop.call(lambda c, now: c.move(MoveRequest(names, MoveMode.LENGTH, [0.0], 0.01, 5.0), now))
        first = loop.snapshot
        assert first is not None
        cpu, began = time.thread_time(), time.monotonic()
        process_cpu = time.process_time()
        end = loop.wait_for(lambda seen: seen.time - first.time >= SECONDS, SECONDS + 5.0)
        assert end is not None
        share = (time.process_time() - process_cpu - (time.thread_time() - cpu)) / (time.monotonic() - began)
        times = [seen.time for seen in loop.since(first.sequence, 0.1)]
    finally:
        loop.stop()
        if silent:
            backend.bus.write(99, ID, SERVOS)
        backend.disconnect()
    periods = [b - a for a, b in pairwise(times)]
    errors = sorted(abs(period - 1.0 / rate) for period in periods)
    return len(periods) / sum(periods), errors[int(0.99 * len(errors))], share


def run_sdk(link: str, rate: float, *, silent: bool = False) -> tuple[float, float, float]:
    """The same figures of a bare GroupSyncRead and GroupSyncWrite loop."""
    port = dynamixel_sdk.PortHandler(link)
    port.openPort()
    port.setBaudRate(BAUD)
    handler = dynamixel_sdk.PacketHandler(2.0)
    reader = dynamixel_sdk.GroupSyncRead(port, handler, PRESENT_CURRENT.address, 10)
    writer = dynamixel_sdk.GroupSyncWrite(port, handler, 116, 4)
    ids = [*range(1, SERVOS), 77] if silent else list(range(1, SERVOS + 1))
    for servo_id in ids:
        reader.addParam(servo_id)
        writer.addParam(servo_id, [0, 0, 0, 0])
    times: list[float] = []
    cpu, began = time.process_time(), time.monotonic()
    due = began
    while time.monotonic() - began < SECONDS:
        pause = due - time.monotonic()
        if pause > 0.0:
            time.sleep(pause)
        due = max(due + 1.0 / rate, time.monotonic())
        times.append(time.monotonic())
        reader.txRxPacket()
        for servo_id in ids:
            if reader.isAvailable(servo_id, 132, 4):
                reader.getData(servo_id, 132, 4)
        writer.txPacket()
    share = (time.process_time() - cpu) / (time.monotonic() - began)
    port.closePort()
    periods = [b - a for a, b in pairwise(times)]
    errors = sorted(abs(period - 1.0 / rate) for period in periods)
    return len(periods) / sum(periods), errors[int(0.99 * len(errors))], share


def run_sdk_alike(link: str, rate: float, *, silent: bool = False) -> tuple[float, float, float]:
    """The peer in a thread of its own with our priority."""
    with ThreadPoolExecutor(1, initializer=claim_processor, initargs=(PRIORITY,)) as thread:
        return thread.submit(run_sdk, link, rate, silent=silent).result()


def alternate(ours: Callable[[], float], peer: Callable[[], float]) -> tuple[list[float], list[float]]:
    """Measure both by turns."""
    pairs = [(ours(), peer()) for _ in range(RUNS)]
    return [a for a, _ in pairs], [b for _, b in pairs]


def main() -> None:
    """Print the claims."""
    no_options(__doc__)
    with emulated_bus() as link:
        rates, peer_rates = alternate(lambda: run_driver(link, FLAT_OUT)[0], lambda: run_sdk_alike(link, FLAT_OUT)[0])
        fixed = [(run_driver(link, FIXED_RATE), run_sdk_alike(link, FIXED_RATE)) for _ in range(RUNS)]
        silent, peer_silent = alternate(
            lambda: run_driver(link, FLAT_OUT, silent=True)[0], lambda: run_sdk_alike(link, FLAT_OUT, silent=True)[0]
        )
    bare = "bare dynamixel-sdk GroupSyncRead + GroupSyncWrite"
    with ThreadPoolExecutor(1) as thread:
        how = thread.submit(claim_processor, PRIORITY).result().split(":")[0]
    middle = statistics.median
    claim("cycle rate", middle(rates), "Hz", better="higher", goal=250.0, runs=RUNS, peer=bare,
          peer_value=middle(peer_rates), note=f"whole control loop, {how}, {spread(rates, 'Hz')}")  # fmt: skip
    jitter, peer_jitter = [a[1] for a, _ in fixed], [b[1] for _, b in fixed]
    claim("p99 jitter", middle(jitter) * 1e3, "ms", better="lower", goal=1.5, runs=RUNS, peer=bare,
          peer_value=middle(peer_jitter) * 1e3,
          note=f"|period - 4 ms| at 250 Hz, {how}; {spread(jitter, 'ms', 1e3)}")  # fmt: skip
    claim("rate with a silent servo", middle(silent), "Hz", better="higher", goal=150.0, runs=RUNS, peer=bare,
          peer_value=middle(peer_silent), note=f"one of four IDs never answers; {spread(silent, 'Hz')}")  # fmt: skip
    shares, peer_shares = [100.0 * a[2] for a, _ in fixed], [100.0 * b[2] for _, b in fixed]
    claim("CPU share", middle(shares), "%", better="lower", goal=None, runs=RUNS, peer=bare,
          peer_value=middle(peer_shares), note=f"of one core at 250 Hz; {spread(shares, '%')}")  # fmt: skip


if __name__ == "__main__":
    main()
