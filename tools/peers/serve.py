# SPDX-License-Identifier: Apache-2.0
"""Serve emulated servos on a pseudo-terminal, for programs that nobody here wrote; until Ctrl-C.

python tools/peers/serve.py /tmp/servos XL330-M288 --count 3
"""

from __future__ import annotations

import argparse
import threading
from pathlib import Path

from softgrip_emulator.plant.motor import Motor
from softgrip_emulator.servos import PlantServo, make_chain, make_servo
from softgrip_emulator.wire.pty import PtyPort

BAUD = 1_000_000
STEP_S = 0.002
SPOOL_RADIUS_M = 0.010


class FreeMotors:
    """Servos whose shafts turn freely, brought up to date whenever the bus asks."""

    def __init__(self, servos: list[PlantServo]) -> None:
        self._servos = servos
        self._motors = [Motor(servo.model.motor, servo.shaft, SPOOL_RADIUS_M) for servo in servos]
        self._now_s = 0.0

    def advance_to(self, now_s: float) -> None:
        """Let them turn until a time of the port's clock [s]; after a long silence only the last second of it."""
        self._now_s = max(self._now_s, now_s - 1.0)
        while self._now_s + STEP_S <= now_s:
            self._now_s += STEP_S
            for servo, motor in zip(self._servos, self._motors, strict=True):
                motor.step(servo.step(self._now_s, STEP_S), 0.0, servo.model.motor.nominal_voltage_v, STEP_S)


def main() -> None:
    """Serve until Ctrl-C."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("port", type=Path)
    arguments.add_argument("model")
    arguments.add_argument("--count", type=int, default=3)
    options = arguments.parse_args()
    servos = [make_servo(options.model, number, baud=BAUD, return_delay_us=0) for number in range(1, options.count + 1)]
    motors = FreeMotors(servos)
    with PtyPort(options.port, make_chain(servos, threading.RLock(), motors.advance_to)):
        print(f"{options.count} {options.model} at {options.port}, {BAUD} baud", flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    main()
