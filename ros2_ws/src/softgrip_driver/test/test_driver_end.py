# SPDX-License-Identifier: Apache-2.0
"""In which order tendon_driver ends: the drives first, whatever the middleware does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from softgrip_driver.nodes.tendon_driver import TendonDriver
from softgrip_time import WallClock


class StuckError(RuntimeError):
    """What a health monitor raises here that cannot be closed."""


def a_driver(done: list[str]) -> Any:
    def stuck() -> None:
        raise StuckError

    loop = SimpleNamespace(
        stop=lambda: done.append("loop stopped"),
        power=lambda *, on: done.append(f"power {on}"),
        keeps_hold=False, has_let_go=True, running=True, clock=WallClock(),
    )  # fmt: skip
    return SimpleNamespace(
        _loop=loop,
        _backend=SimpleNamespace(disconnect=lambda *, keep_torque: done.append(f"disconnected, torque {keep_torque}")),
        _disarm=lambda: done.append("disarmed"),
        _stop_monitor=stuck,
    )


def test_the_drives_are_safe_before_the_health_monitor_is_closed() -> None:
    done: list[str] = []
    with pytest.raises(StuckError):
        TendonDriver.disconnect(cast("TendonDriver", a_driver(done)))
    assert done == ["loop stopped", "disconnected, torque False", "disarmed"]


def test_a_driver_that_is_deactivated_lets_go_before_the_health_monitor_is_closed() -> None:
    done: list[str] = []
    with pytest.raises(StuckError):
        TendonDriver.on_deactivate(cast("TendonDriver", a_driver(done)), cast("Any", None))
    assert done == ["power False", "disarmed"]
