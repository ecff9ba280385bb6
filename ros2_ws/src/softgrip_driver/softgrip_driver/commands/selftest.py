# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_driver selftest`: how fast and how well the bus runs, and what to do when it does not."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from softgrip_driver.autogroup import AUTOGROUP_REMEDY, has_autogroups
from softgrip_driver.commands.common import DONE, FAILED, add_bus_options, add_drive_option, number, parser, run
from softgrip_driver.usb_adapter import LATENCY_REMEDY, SLOW_ADAPTER_S
from softgrip_driver.wizard.drive_setup import BusMeasurement, drive_setup

TEXT = """Measure the servo bus with the driver's own cycles: rate, jitter, lost replies, USB latency, return delay.

A cycle is the group read of all servos and what else the driver asks in it. Nothing moves. Prints each cause of
slowness with its fix in words; exit code 1 when the wanted rate is not reached."""


def causes(found: BusMeasurement, required_rate: float, *, autogroups: bool = False) -> list[str]:
    """Return every cause of slowness or loss that the figures show, with its fix.

    Args:
        found: the figures.
        required_rate: [Hz] of cycles.
        autogroups: whether the kernel shares processors out among sessions.
    """
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
    if autogroups and found.median <= 1.0 / required_rate < found.p99:
        texts.append(
            f"a cycle takes {found.median * 1e3:.1f} ms as a rule, but one in a hundred {found.p99 * 1e3:.1f} ms: "
            f"where other programs run, {AUTOGROUP_REMEDY}"
        )
    return texts


def work(options: argparse.Namespace) -> int:
    """Measure, judge, print."""
    setup = drive_setup(options.drive)
    bus = setup.make_bus(options.port, options.baud, options.reply_margin, None)
    bus.open()
    try:
        found = setup.measure(bus, options.seconds)
    finally:
        bus.close()
    timer = "none" if found.latency_timer is None else f"{found.latency_timer * 1e3:.0f} ms"
    print(f"servos              {found.servos} at {found.baud} baud")
    print(f"driver's cycles     {found.rate:.0f} Hz, median {found.median * 1e3:.2f} ms, p99 {found.p99 * 1e3:.2f} ms")
    print(f"bytes alone         {found.wire_time * 1e3:.2f} ms")
    print(f"lost answers        {found.lost_share:.3%}, damaged packets {found.corrupt}")
    print(f"USB latency timer   {timer}, replies after {found.turnaround * 1e3:.1f} ms")
    if found.return_delays:
        print(f"return delays       {', '.join(f'{i}: {d * 1e6:.0f} us' for i, d in found.return_delays.items())}")
    for text in causes(found, options.rate, autogroups=has_autogroups()):
        print(f"-> {text}")
    good = found.rate >= options.rate
    print(f"{'reaches' if good else 'does not reach'} the wanted {options.rate:.0f} Hz")
    return DONE if good else FAILED


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    arguments = parser("selftest", TEXT)
    add_bus_options(arguments)
    add_drive_option(arguments)
    arguments.add_argument(
        "--seconds", type=number(0.1, 3600.0), default=5.0, metavar="S", help="how long, default %(default)s"
    )
    arguments.add_argument(
        "--rate", type=number(1.0, 1000.0), default=100.0, metavar="HZ", help="wanted loop rate, default %(default)s"
    )
    return run(work, arguments, args)


if __name__ == "__main__":
    sys.exit(main())
