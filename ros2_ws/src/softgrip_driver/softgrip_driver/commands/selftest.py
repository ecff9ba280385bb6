# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_driver selftest`: how fast and how well the bus runs, and what to do when it does not."""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from softgrip_driver.commands.common import DONE, FAILED, add_bus_options, number, parser, run
from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.dynamixel.adapter import LATENCY_REMEDY, SLOW_ADAPTER_S, latency_timer
from softgrip_driver.dynamixel.backend import FAST_BLOCK, DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration, identify
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.errors import ConfigurationError, DeviceNotFoundError
from softgrip_driver.tendon.units import Spool, TorqueModel

TEXT = """Measure the servo bus with the driver's own cycles: rate, jitter, lost replies, USB latency, return delay.

A cycle is the group read of all servos and what else the driver asks in it. Nothing moves. Prints each cause of
slowness with its fix in words; exit code 1 when the wanted rate is not reached."""

#: bytes of a fast group read's instruction, of its answer without what the servos say, and of a read of one servo
GROUP_BYTES, ANSWER_BYTES, SLOW_BYTES = 14, 8, 14 + 18
#: of one servo in the answer: error, ID, data, checksum
SERVO_BYTES = 4 + FAST_BLOCK[1]
BITS_PER_BYTE = 10


@dataclass(frozen=True)
class Measurement:
    """What was measured.

    Attributes:
        servos: how many answer.
        baud: [1/s]
        rate: [Hz] of cycles one after the other.
        median, p99: [s] of one cycle.
        turnaround: [s] that a reply takes beyond its bytes.
        lost_share: share of the answers that did not come.
        corrupt: damaged packets.
        return_delays: [s] by ID.
        latency_timer: [s] of the USB adapter; None where it has none.
    """

    servos: int
    baud: int
    rate: float
    median: float
    p99: float
    turnaround: float
    lost_share: float
    corrupt: int
    return_delays: dict[int, float]
    latency_timer: float | None

    @property
    def wire_time(self) -> float:
        """[s] that the bytes alone need."""
        group = GROUP_BYTES + ANSWER_BYTES + self.servos * (1 + SERVO_BYTES)
        return (group + SLOW_BYTES) * BITS_PER_BYTE / self.baud


def measure(bus: Bus, seconds: float) -> Measurement:
    """Run the driver's cycles as fast as can be, without its orders.

    Raises:
        DeviceNotFoundError: nobody answers.
        ConfigurationError: a servo of a model that the driver does not know.
    """
    found = bus.broadcast_ping(0.5)
    ids = sorted(found)
    if not ids:
        raise DeviceNotFoundError(
            f"{bus.port.port_name}: expected servos at {bus.port.baudrate} baud, found none; run scan"
        )
    turnaround = bus.turnaround(ids[0])
    bus.port.reply_margin = max(bus.port.reply_margin, 2.0 * turnaround)
    servos = [identify(bus, _servo(servo_id, number)).servo for servo_id, (number, _) in sorted(found.items())]
    delays = {i: bus.read(i, reg.RETURN_DELAY, attempts=3) * reg.RETURN_DELAY_SECONDS_PER_UNIT for i in ids}
    backend = DynamixelBackend(bus, servos, watchdog=0.0)
    backend.fast = all(servo.fast_sync_read for servo in servos)
    lost, corrupt = bus.counters.lost, bus.counters.corrupt
    durations: list[float] = []
    began = bus.clock.now_s()
    while bus.clock.now_s() - began < seconds:
        start = bus.clock.now_s()
        backend.read()
        durations.append(bus.clock.now_s() - start)
    ordered = sorted(durations)
    return Measurement(
        len(ids), bus.port.baudrate, 1.0 / statistics.fmean(durations), statistics.median(durations),
        ordered[int(0.99 * (len(ordered) - 1))], turnaround,
        (bus.counters.lost - lost) / (len(durations) * len(ids)), bus.counters.corrupt - corrupt, delays,
        latency_timer(bus.port.port_name),
    )  # fmt: skip


def _servo(servo_id: int, number: int) -> ServoConfiguration:
    """Return a configuration that is good for reading."""
    model = next((model for model in reg.MODELS.values() if model.number == number), None)
    if model is None:
        raise ConfigurationError(
            f"ID {servo_id}: expected a model of {sorted(reg.MODELS)}, found "
            f"{reg.MODEL_NAMES.get(number, 'an unknown one')} ({number})"
        )
    torque = TorqueModel(model.torque_per_ampere, model.no_load_current)
    return ServoConfiguration(f"ID {servo_id}", servo_id, model, Spool(0.01, 1), torque)


def causes(found: Measurement, required_rate: float) -> list[str]:
    """Return every cause of slowness or loss that the figures show, with its fix."""
    texts = []
    if found.latency_timer is not None and found.latency_timer > 0.001:
        texts.append(
            f"the USB adapter waits {found.latency_timer * 1e3:.0f} ms before it hands bytes over: {LATENCY_REMEDY}"
        )
    elif found.turnaround > SLOW_ADAPTER_S:
        texts.append(
            f"a reply takes {found.turnaround * 1e3:.0f} ms beyond its bytes: where the port is a USB adapter's, "
            f"{LATENCY_REMEDY}"
        )
    slow = {i: delay for i, delay in found.return_delays.items() if delay > 0.0}
    if slow:
        texts.append(
            f"servos {sorted(slow)} wait up to {max(slow.values()) * 1e6:.0f} us before they answer: set their "
            "return delay to 0 with `setup --id N` (the driver does so itself when write_eeprom is on)"
        )
    if found.wire_time > 0.5 / required_rate:
        texts.append(
            f"at {found.baud} baud the bytes alone take {found.wire_time * 1e3:.1f} ms of the "
            f"{1e3 / required_rate:.1f} ms of a cycle: raise the baud rate with `setup --new-baud`"
        )
    if found.lost_share > 0.001 or found.corrupt:
        texts.append(
            f"{found.lost_share:.2%} of the answers are lost and {found.corrupt} packets damaged: check cable, "
            "connectors, common ground and supply; each ID must be used once"
        )
    if not texts and found.rate < required_rate:
        texts.append(
            f"a cycle takes {found.median * 1e3:.2f} ms, its bytes {found.wire_time * 1e3:.2f} ms: the rest is "
            "this computer; close other programs, allow real-time priority (rtprio in limits.conf), use a faster one"
        )
    return texts


def work(options: argparse.Namespace) -> int:
    """Measure, judge, print."""
    bus = Bus(options.port, options.baud, options.reply_margin)
    bus.open()
    try:
        found = measure(bus, options.seconds)
    finally:
        bus.close()
    timer = "none" if found.latency_timer is None else f"{found.latency_timer * 1e3:.0f} ms"
    print(f"servos              {found.servos} at {found.baud} baud")
    print(f"driver's cycles     {found.rate:.0f} Hz, median {found.median * 1e3:.2f} ms, p99 {found.p99 * 1e3:.2f} ms")
    print(f"bytes alone         {found.wire_time * 1e3:.2f} ms")
    print(f"lost answers        {found.lost_share:.3%}, damaged packets {found.corrupt}")
    print(f"USB latency timer   {timer}, replies after {found.turnaround * 1e3:.1f} ms")
    print(f"return delays       {', '.join(f'{i}: {d * 1e6:.0f} us' for i, d in found.return_delays.items())}")
    for text in causes(found, options.rate):
        print(f"-> {text}")
    good = found.rate >= options.rate
    print(f"{'reaches' if good else 'does not reach'} the wanted {options.rate:.0f} Hz")
    return DONE if good else FAILED


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    arguments = parser("selftest", TEXT)
    add_bus_options(arguments)
    arguments.add_argument(
        "--seconds", type=number(0.1, 3600.0), default=5.0, metavar="S", help="how long, default %(default)s"
    )
    arguments.add_argument(
        "--rate", type=number(1.0, 1000.0), default=100.0, metavar="HZ", help="wanted loop rate, default %(default)s"
    )
    return run(work, arguments, args)


if __name__ == "__main__":
    sys.exit(main())
