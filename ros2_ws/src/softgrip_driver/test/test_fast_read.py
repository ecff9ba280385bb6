# SPDX-License-Identifier: Apache-2.0
"""Fast Sync Read that is not answered: how often it is tried again; and a silent servo in front of others."""

from __future__ import annotations

from itertools import pairwise

import pytest

from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.dynamixel.bus import BusReply
from softgrip_driver.dynamixel.registers import MODELS
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_emulator.dynamixel.table import load_model
from softgrip_testing.virtual_bus import VirtualBus
from softgrip_testing.virtual_clock import VirtualClock

MODEL = MODELS["XL330-M288"]
PERIOD_S = 0.01


class DeafBus(VirtualBus):
    """A bus on which, from and until some time, nobody answers a fast read, or no group read at all."""

    def __init__(self, clock: VirtualClock) -> None:
        super().__init__([EmulatedServo(load_model("XL330-M288"), 1)], clock.now_s, clock)
        self.tried: list[float] = []
        self.knows_fast = self.is_there = True

    def fast_sync_read(self, servo_ids: list[int], address: int, size: int) -> dict[int, BusReply]:
        self.tried.append(self.clock.now_s())
        return super().sync_read(servo_ids, address, size) if self.knows_fast and self.is_there else {}

    def sync_read(self, servo_ids: list[int], address: int, size: int) -> dict[int, BusReply]:
        return super().sync_read(servo_ids, address, size) if self.is_there else {}

    def push_through(self, duration: float) -> None:
        """No wire, no bytes that anybody waits for."""


@pytest.fixture
def bus() -> DeafBus:
    return DeafBus(VirtualClock())


@pytest.fixture
def backend(bus: DeafBus) -> DynamixelBackend:
    torque = TorqueModel(MODEL.torque_per_ampere, MODEL.no_load_current)
    made = DynamixelBackend(bus, [ServoConfiguration("t", 1, MODEL, Spool(0.010, 1), torque)], watchdog=0.0)
    made.connect()
    return made


def goes_on(backend: DynamixelBackend, bus: DeafBus, seconds: float) -> list[float]:
    """Read for some time; return when the fast read was tried [s]."""
    bus.tried.clear()
    for _ in range(round(seconds / PERIOD_S)):
        bus.clock.advance(bus.clock.now_s() + PERIOD_S)
        backend.read()
    return list(bus.tried)


def test_a_fast_read_that_is_answered_is_used_in_every_cycle(backend: DynamixelBackend, bus: DeafBus) -> None:
    assert len(goes_on(backend, bus, 1.0)) == 100


def test_one_that_nobody_knows_is_tried_less_and_less(backend: DynamixelBackend, bus: DeafBus) -> None:
    bus.knows_fast = False
    tried = goes_on(backend, bus, 200.0)
    waits = [after - before for before, after in pairwise(tried)]
    assert waits == pytest.approx([1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0], abs=2 * PERIOD_S)
    assert backend.read()["t"].position is not None


def test_one_that_was_spoilt_once_is_used_again_after_a_second(backend: DynamixelBackend, bus: DeafBus) -> None:
    for _ in range(3):
        bus.knows_fast = False
        goes_on(backend, bus, PERIOD_S)
        bus.knows_fast = True
        assert len(goes_on(backend, bus, 2.0)) == pytest.approx(100, abs=2)


def test_a_bus_that_was_away_for_long_is_read_fast_a_second_after_it_is_back(
    backend: DynamixelBackend, bus: DeafBus
) -> None:
    bus.is_there = False
    goes_on(backend, bus, 300.0)
    bus.is_there = True
    assert len(goes_on(backend, bus, 3.0)) >= 195


@pytest.mark.parametrize("silent", [(1,), (2,), (1, 2)])
def test_behind_a_silent_servo_the_others_are_heard_again_within_a_few_cycles(silent: tuple[int, ...]) -> None:
    """Real ones wait for its answer, so that it is asked last (ROBOTIS-GIT/DynamixelSDK issue 364)."""
    clock = VirtualClock()
    servos = [EmulatedServo(load_model("XL330-M288"), number) for number in (1, 2, 3)]
    torque = TorqueModel(MODEL.torque_per_ampere, MODEL.no_load_current)
    rows = [ServoConfiguration(f"t{one.device_id}", one.device_id, MODEL, Spool(0.010, 1), torque) for one in servos]
    backend = DynamixelBackend(VirtualBus(servos, clock.now_s, clock), rows, watchdog=0.0)
    backend.connect()
    for servo in servos:
        servo.silenced = servo.device_id in silent
    heard = []
    for _ in range(100):
        clock.advance(clock.now_s() + PERIOD_S)
        heard.append(set(backend.read()))
    others = {f"t{number}" for number in (1, 2, 3) if number not in silent}
    assert all(seen == others for seen in heard[1 + len(silent) :])
    for servo in servos:
        servo.silenced = False
    for _ in range(300):
        clock.advance(clock.now_s() + PERIOD_S)
        heard.append(set(backend.read()))
    assert heard[-1] == {"t1", "t2", "t3"}
