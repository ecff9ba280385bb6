# SPDX-License-Identifier: Apache-2.0
"""The Dynamixel driver against three servos whose wire is another project's: how many checks hold, how many bytes fail.

`rust_servos.rs` says how the program is built. Each round is a power-on of its own, so that what is said right after
it is seen often; `--rounds 50` beside other work looks for a false `rebooted`:

    python tools/peers/rust_servos.py dynamixel2-rs/target/release/examples/rust_servos
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from checks import Checks

from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration, required_eeprom
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import MODELS, TORQUE_ENABLE
from softgrip_driver.errors import DriverError
from softgrip_driver.tendon.gripper import GripperController, MoveMode, MoveRequest, Policies, Ticket
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.loop import BusLoop
from softgrip_driver.tendon.motions import MoveOutcome
from softgrip_driver.tendon.units import Spool, TorqueModel

SLACKS_M = (0.006, 0.009, 0.012)
STIFFNESS_N_M = 1500.0
BAUD, RATE_HZ = 1_000_000, 100.0
MODEL = MODELS["XL330-M288"]
#: [s] for a reply, of silence that is a fault, for a motion: both programs are threads of a busy machine
REPLY_S, SILENT_S, MOVE_S = 0.1, 0.3, 60.0
TENSION_N, LENGTH_M = 10.0, 0.004
#: [m] of a zero, [m] of a length, [N] beside a tension that is asked for: docs/driver.md
ZERO_M, NEAR_M, NEAR_N = 1e-3, 3e-4, 2.5


class Hand:
    """Tendons under the driver's own loop."""

    def __init__(self, loop: BusLoop, check: Checks) -> None:
        self.loop, self.check = loop, check

    def does(self, what: str, request: Callable[[GripperController, float], Ticket]) -> None:
        """Carry a request out to its end."""
        ticket = self.loop.call(request)
        seen = self.loop.wait_for(lambda one: ticket.result(one.drives)[0] is not None, MOVE_S)
        outcome, reason = ticket.result(seen.drives) if seen else (None, "no end")
        self.check(what, holds=outcome is MoveOutcome.REACHED, found=f"{outcome} {reason}")

    def moves(self, what: str, mode: MoveMode, target: float) -> None:
        """Move all to a length or a tension."""
        self.does(what, lambda controller, now: controller.move(MoveRequest((), mode, (target,), 0.01, 20.0), now))

    def forces_n(self) -> list[float]:
        """Return what the springs pull with, from where the spools stand."""
        stands = self.loop.call(lambda controller, _: [one.position for one in controller.drives.values()])
        return [max(0.0, STIFFNESS_N_M * (at - slack)) for at, slack in zip(stands, SLACKS_M, strict=True)]


def uses(hand: Hand) -> None:
    """Power on, home, go to a length and a tension, release."""
    check, loop = hand.check, hand.loop
    read = loop.wait_for(lambda seen: all(drive.time > 0.0 for drive in seen.drives), 5.0)
    check("every servo is read", holds=read is not None)
    loop.power(on=True)
    loop.wait_for(lambda seen: seen.time > loop.clock.now_s() + 0.5, 0.5)
    check("no fault right after power-on", holds=_no_fault(loop), found=_faults(loop))
    hand.does("homes", lambda controller, now: controller.home(now))
    zeros = loop.call(lambda controller, _: [one.zero for one in controller.drives.values()])
    for zero, slack in zip(zeros, SLACKS_M, strict=True):
        check("the zero is where the spring begins", holds=zero is not None and abs(zero - slack) < ZERO_M, found=zero)
    hand.moves("goes to a length", MoveMode.LENGTH, LENGTH_M)
    for drive in loop.snapshot.drives:
        check("stands there", holds=abs(drive.pulled_length_m - LENGTH_M) < NEAR_M, found=drive.pulled_length_m)
    hand.moves("goes to a tension", MoveMode.TENSION, TENSION_N)
    for drive, force in zip(loop.snapshot.drives, hand.forces_n(), strict=True):
        check("the spring pulls so much", holds=abs(force - TENSION_N) < NEAR_N, found=f"{force:.1f} N")
        near = abs(drive.tension - force) < 2.0 * drive.tension_stddev
        check("the tension is within twice its deviation", holds=near, found=f"{drive.tension:.1f}, true {force:.1f} N")
    hand.does("releases", lambda controller, now: controller.release(now))
    check("no fault at the end", holds=_no_fault(loop), found=_faults(loop))


def _no_fault(loop: BusLoop) -> bool:
    return not any(drive.fault for drive in loop.snapshot.drives)


def _faults(loop: BusLoop) -> list[str]:
    return [f"{drive.tendon}: {drive.fault} ({drive.fault_reason})" for drive in loop.snapshot.drives if drive.fault]


def checked(program: Path, check: Checks) -> tuple[str, Sequence[int]]:
    """Do one round; return what the program counted, and transactions, lost and corrupt replies of the driver."""
    with subprocess.Popen(
        [program, *map(str, SLACKS_M)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as servos:
        assert servos.stdout is not None
        bus = Bus(servos.stdout.readline().strip(), BAUD, REPLY_S)
        try:
            drives(bus, check)
        except DriverError as error:
            check("it goes on to its end", holds=False, found=repr(error))
        finally:
            bus.close()
        said, _ = servos.communicate()
    return said.strip(), (bus.counters.transactions, bus.counters.lost, bus.counters.corrupt)


def drives(bus: Bus, check: Checks) -> None:
    """Look who is on the bus, set everybody up, use them, leave."""
    torque, limits = TorqueModel(MODEL.torque_per_ampere, MODEL.no_load_current), TendonLimits(no_reply=SILENT_S)
    rows = [ServoConfiguration(f"t{k}", k, MODEL, Spool(0.010, 1), torque) for k in range(1, len(SLACKS_M) + 1)]
    bus.open()
    found = bus.broadcast_ping(0.3)
    check("all answer a ping to all", holds=sorted(found) == [one.servo_id for one in rows], found=found)
    bus.close()
    backend = DynamixelBackend(bus, rows, watchdog=2.0 * SILENT_S)
    for identity in backend.connect():
        check("it is named", holds=identity.device.startswith(f"{MODEL.name}/{MODEL.number}"), found=identity)
    for one in rows:
        for item, value in required_eeprom(one).items():
            kept = bus.read(one.servo_id, item, 3)
            check(f"{item.name} is kept", holds=kept == value, found=kept)
    loop = BusLoop(
        backend, GripperController({one.tendon: limits for one in rows}, Policies(), None, 1.0 / RATE_HZ), RATE_HZ
    )
    loop.start()
    try:
        uses(Hand(loop, check))
    finally:
        loop.stop()
    for one in rows:
        off = bus.read(one.servo_id, TORQUE_ENABLE, 3)
        check("torque is off", holds=off == 0, found=off)
    backend.disconnect()


def main() -> int:
    """Print the count and what differs."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("program", type=Path)
    arguments.add_argument("--rounds", type=int, default=3)
    options = arguments.parse_args()
    check, began = Checks(), time.monotonic()
    totals = [0, 0, 0]
    for _ in range(options.rounds):
        said, seen = checked(options.program.resolve(), check)
        totals = [a + b for a, b in zip(totals, seen, strict=True)]
        print(said, flush=True)
    return check.report(
        f"{options.rounds} power-ons",
        f"; {totals[0]} transactions, {totals[1]} lost, {totals[2]} corrupt; {time.monotonic() - began:.0f} s",
    )


if __name__ == "__main__":
    sys.exit(main())
