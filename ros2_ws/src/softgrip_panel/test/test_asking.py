# SPDX-License-Identifier: Apache-2.0
"""A stop is asked for again while no answer comes; what may not be done twice is asked for once."""

from __future__ import annotations

import asyncio
from typing import Any

from rclpy.task import Future

from softgrip_panel.model import acts
from softgrip_panel.nodes.cell_calls import ask


class Client:
    """A client whose first requests are lost with the link that they went by."""

    def __init__(self, lost: int) -> None:
        self._lost = lost
        self.asked = 0
        self.forgotten = 0

    def call_async(self, request: Any) -> Future:
        self.asked += 1
        future = Future()
        if self.asked > self._lost:
            future.set_result(request)
        return future

    def remove_pending_request(self, _future: Future) -> None:
        self.forgotten += 1


def test_a_lost_request_is_asked_again_and_those_that_were_lost_are_forgotten() -> None:
    client = Client(lost=2)
    answered = asyncio.run(ask(client, "stop", timeout_s=60.0, repeat_s=0.01))
    assert answered is not None
    assert answered.result() == "stop"
    assert client.asked == 3
    assert client.forgotten == 2


def test_nobody_waits_longer_than_asked_for() -> None:
    client = Client(lost=1_000_000)
    assert asyncio.run(ask(client, "stop", timeout_s=0.05, repeat_s=0.01)) is None
    assert client.asked == client.forgotten > 1


def test_without_a_repetition_there_is_one_request() -> None:
    client = Client(lost=1)
    assert asyncio.run(ask(client, "reset", timeout_s=0.02, repeat_s=0.02)) is None
    assert client.asked == 1


def test_of_all_that_the_page_can_ask_only_the_stop_is_urgent() -> None:
    assert acts.estop().is_urgent
    assert not acts.estop_reset().is_urgent
    assert not acts.home().is_urgent
    assert not acts.release().is_urgent
