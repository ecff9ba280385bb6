# SPDX-License-Identifier: Apache-2.0
"""Rebooting a servo, one short transaction a step, so that a loop can go on with the others meanwhile."""

from __future__ import annotations

from collections.abc import Iterator

from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.errors import CorruptReplyError, DeviceNotFoundError, NoReplyError

#: [s] for a reboot: 0.4 s were measured, the maker's own code waits 3 s
REBOOT_TIMEOUT = 4.0


def restart(bus: Bus, servo_id: int) -> Iterator[None]:
    """Reboot a servo, once more where neither its answer nor its state says that it did.

    Some restart without a word (DynamixelSDK#283), and on a bad line the order may be lost.

    Raises:
        DeviceNotFoundError: it does not come back.
    """
    deadline = bus.clock.now_s() + REBOOT_TIMEOUT
    is_restarted = False
    while not is_restarted:
        # It may be booting already.
        yield from _until_it_answers(bus, servo_id)
        try:
            bus.reboot(servo_id)
            is_restarted = True
        except (NoReplyError, CorruptReplyError):
            yield from _until_it_answers(bus, servo_id)
            is_restarted = not _in_error(bus, servo_id) or bus.clock.now_s() > deadline
    yield from _until_it_answers(bus, servo_id)


def _until_it_answers(bus: Bus, servo_id: int) -> Iterator[None]:
    deadline = bus.clock.now_s() + REBOOT_TIMEOUT
    while True:
        yield
        try:
            bus.ping(servo_id)
        except (NoReplyError, CorruptReplyError):
            if bus.clock.now_s() > deadline:
                raise DeviceNotFoundError(
                    f"servo {servo_id}: expected it back within {REBOOT_TIMEOUT:.0f} s of its reboot, "
                    "found silence; switch its supply off and on"
                ) from None
        else:
            return


def _in_error(bus: Bus, servo_id: int) -> bool:
    """Whether a servo has a hardware error, also where it does not say."""
    try:
        return bus.read(servo_id, reg.HARDWARE_ERROR) != 0
    except (NoReplyError, CorruptReplyError):
        return True
