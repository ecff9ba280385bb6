# SPDX-License-Identifier: Apache-2.0
"""The operator's page on a whole emulated cell, by clicks in a real Chromium."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softgrip_testing.browser import PanelBrowser

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def test_a_click_stops_the_cell_and_reset_wants_control(launch: Callable[..., Any], tmp_path: Path) -> None:
    cell = launch(
        "ros2", "launch", "softgrip_bringup", "cell.launch.yaml", f"out:={tmp_path}", "panel:=true", "record:=false"
    )
    cell.wait_for("the page is at", 60.0)
    address = re.search(r"the page is at (http://127\.0\.0\.1:\d+)/", cell.output)
    assert address is not None
    with PanelBrowser(address[1]) as browser:
        browser.log_in("Ada")
        browser.wait(lambda: browser.text("#mode") in {"Idle", "Holding"}, "a cell that is up")
        browser.wait_for_text("#stop-note", "torque of all tendons off")  # as the driver's policy says
        browser.wait(
            lambda: int(browser.script("return document.getElementById('camera').dataset.number || 0")) > 2, "frames"
        )
        browser.find("#estop").click()
        browser.wait_for_text("#estop-said", "stopped (let_go)")
        browser.wait_for_text("#mode", "Emergency stop")
        # by the driver's own word, not the page's
        status = cell.ask("topic", "echo", "--once", "/tendon/status")
        assert "estop: true" in status
        assert set(re.findall(r"state: (\d)", status)) == {"6"}  # STOPPED, every tendon
        reset = browser.find("[data-name='reset']")
        assert not reset.is_enabled()  # nobody has control yet
        browser.press("take")
        browser.press("reset")
        browser.wait_for_text(".dialog", "The drives take hold where they stand")
        browser.press("reset-confirm")
        browser.wait(lambda: browser.text("#mode") == "Idle", "the end of the stop")
    acts = (tmp_path / "panel" / "acts.jsonl").read_text()
    assert re.search(r'"who": "Ada", "act": "estop", .*"success": true', acts)
    assert re.search(r'"who": "Ada", "act": "estop_reset", .*"success": true', acts)
    audit = cell.ask("service", "call", "/cell/list_fingers", "softgrip_interfaces/srv/ListFingers", "{}")
    assert "PW-I-01" in audit
    cell.interrupt()
    cell.wait_for_end(30.0)
