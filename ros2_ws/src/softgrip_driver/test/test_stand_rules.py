# SPDX-License-Identifier: Apache-2.0
"""A Mark-10 stand says nothing about a command it did not take: what is read back before it may move."""

from __future__ import annotations

import pytest

from softgrip_driver.errors import DeviceRefusedError
from softgrip_driver.rig.mark10_stand import Mark10Stand


class Port:
    """A stand that answers x (travel), v and w (limits), a (speed) and p (status), and keeps what it was sent."""

    def __init__(self, **answers: bytes) -> None:
        self.answers = {b"x": b"0.00 mm", b"v": b"12.00 mm", b"w": b"12.00 mm", b"a": b"40.0 mm/min", b"p": b"D"}
        self.answers |= {name.encode(): answer for name, answer in answers.items()}
        self.sent: list[bytes] = []
        self.is_open = False

    def open(self) -> None:
        self.is_open = True

    def drain(self) -> None:
        pass

    def write(self, data: bytes) -> None:
        self.sent.append(data)

    def read_line(self) -> bytes:
        return self.answers[self.sent[-1]]


def test_it_is_stopped_before_anything_else_when_it_is_opened() -> None:
    """It may still be moving from before."""
    port = Port()
    Mark10Stand(port).open()  # type: ignore[arg-type]
    assert port.sent[0] == b"s"


def test_it_moves_up_when_limit_and_speed_were_taken() -> None:
    port = Port()
    Mark10Stand(port).start(0.012, 40e-3 / 60.0)  # type: ignore[arg-type]
    assert port.sent[-1] == b"lu"
    assert b"h012.00" in port.sent
    assert b"e0040.0" in port.sent


@pytest.mark.parametrize(
    ("answers", "expected"),
    [({"v": b"99.00 mm"}, "take a limit of 12.00 mm"), ({"a": b"1100.0 mm/min"}, "take a speed of 40.0 mm/min")],
    ids=["limit", "speed"],
)
def test_it_does_not_move_when_its_limit_or_its_speed_is_another(answers: dict[str, bytes], expected: str) -> None:
    port = Port(**answers)
    with pytest.raises(DeviceRefusedError, match=expected):
        Mark10Stand(port).start(0.012, 40e-3 / 60.0)  # type: ignore[arg-type]
    assert not {b"lu", b"ld", b"u", b"d"} & set(port.sent)


@pytest.mark.parametrize(("fastest", "may_be_unheard"), [(b"1100.0 mm/min", False), (b"40.0 mm/min", True)])
def test_a_stand_that_is_too_slow_is_named_with_what_it_can_do(fastest: bytes, may_be_unheard: bool) -> None:
    """It keeps the speed of before; asked for its maximum (j) it says so, unless it does not listen at all."""

    class Slow(Port):
        def read_line(self) -> bytes:
            return fastest if self.sent[-1] == b"a" and b"j" in self.sent else super().read_line()

    port = Slow()
    with pytest.raises(DeviceRefusedError, match=r"its fastest is .* ask for at most 0\.\d+ m/s") as refused:
        Mark10Stand(port).start(0.012, 1440e-3 / 60.0)  # type: ignore[arg-type]
    assert ("PC control is off" in str(refused.value)) == may_be_unheard
    assert not {b"lu", b"ld", b"u", b"d"} & set(port.sent)
