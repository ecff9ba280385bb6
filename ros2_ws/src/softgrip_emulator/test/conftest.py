# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the emulator's tests."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import dynamixel_sdk
import numpy as np
import pytest

from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_emulator.dynamixel.table import load_model
from softgrip_emulator.wire.pty import PtyPort
from softgrip_model.profile import load_directory
from softgrip_testing.ideal_finger import ideal_finger

PROFILES = Path(__file__).parents[2] / "softgrip_bringup" / "profiles"


@pytest.fixture(scope="session")
def profiles():
    return load_directory(PROFILES)


@pytest.fixture(scope="session")
def until():
    """Wait for a condition with a deadline [s]; says whether it came true."""

    def wait(condition, deadline_s=3.0, pause_s=0.002):
        end_s = time.monotonic() + deadline_s
        while not condition():
            if time.monotonic() > end_s:
                return False
            time.sleep(pause_s)
        return True

    return wait


@pytest.fixture(autouse=True)
def patient_sdk(monkeypatch):
    """The SDK waits 34 ms for a reply, less than a busy test machine may take to run the emulator's thread."""
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 100)


@pytest.fixture
def servos():
    """Three XL330 with IDs 1, 2, 3 at 1 Mbaud without return delay."""
    model = load_model("xl330_m288")
    return [EmulatedServo(model, number, baud=1_000_000, return_delay_us=0) for number in (1, 2, 3)]


@pytest.fixture
def bus(servos, tmp_path):
    """The servos on a pseudo-terminal."""
    with PtyPort(tmp_path / "servos", DynamixelChain(servos)) as port:
        yield port


@pytest.fixture
def sdk(bus):
    """dynamixel-sdk on the other end: (port handler, packet handler)."""
    port = dynamixel_sdk.PortHandler(str(bus.link))
    assert port.openPort()
    assert port.setBaudRate(1_000_000)
    yield port, dynamixel_sdk.PacketHandler(2.0)
    port.closePort()


@pytest.fixture(scope="session")
def write():
    """Write an item of a servo by name, as an instruction would; returns the error field."""

    def write_item(servo, name, value, now_s=0.0):
        item = next(item for item in servo.model.items if item.name == name)
        data = (value & ((1 << (8 * item.size)) - 1)).to_bytes(item.size, "little")
        return servo.write_for_host(item.address, data, now_s).error

    return write_item


@pytest.fixture(scope="session")
def read():
    """Read an item of a servo by name, as an instruction would."""

    def read_item(servo, name, now_s=0.0):
        item = next(item for item in servo.model.items if item.name == name)
        reply = servo.read_for_host(item.address, item.size, now_s)
        return int.from_bytes(reply.parameters, "little", signed=item.signed)

    return read_item


@pytest.fixture(scope="session")
def plain_finger():
    """A finger without scatter or creep and hardly any stretch: E 21.89 MPa, w 13, h 3, l 10, link 35 mm."""

    def make(radii_mm=(8.5,) * 6, mu=0.0, presliding_m=1e-4):
        return replace(
            ideal_finger(),
            entry_radius_m=np.array(radii_mm[0::2]) * 1e-3,
            exit_radius_m=np.array(radii_mm[1::2]) * 1e-3,
            friction_pressure=np.full(6, mu),
            presliding_m=presliding_m,
        )

    return make
