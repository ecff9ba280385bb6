# SPDX-License-Identifier: Apache-2.0
"""A rig that could not be opened whole has nothing of it left open."""

from __future__ import annotations

import pytest

from softgrip_driver.errors import ConfigurationError, CorruptReplyError, DeviceRefusedError, DriverError, NoReplyError
from softgrip_driver.rig.bench import Bench
from softgrip_driver.rig.devices import DeviceIdentity


class Device:
    def __init__(self, error: DriverError | None = None) -> None:
        self._error, self.is_open = error, False

    def open(self) -> DeviceIdentity:
        if self._error is not None:
            raise self._error
        self.is_open = True
        return DeviceIdentity("a device")

    def close(self) -> None:
        self.is_open = False


@pytest.mark.parametrize(
    "error",
    [
        DeviceRefusedError("no", 1),
        CorruptReplyError("nonsense"),
        ConfigurationError("another unit"),
        NoReplyError("silent"),
    ],
    ids=["refused", "nonsense", "wrong settings", "silent"],
)
def test_a_stage_whose_gauge_can_not_be_opened_is_closed_again(error: DriverError) -> None:
    """It would keep its port, and nobody would stop it."""
    stage = Device()
    with pytest.raises(type(error)):
        Bench(stage, Device(error)).open()  # type: ignore[arg-type]
    assert not stage.is_open
