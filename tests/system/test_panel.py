# SPDX-License-Identifier: Apache-2.0
"""The operator's page on a whole emulated cell, by clicks in a real Chromium."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softgrip_cell.storage import Database, Library
from softgrip_testing.browser import POINT_ASKED, PanelBrowser

pytest.importorskip("nicegui", reason="make panel-setup")
pytest.importorskip("selenium", reason="make panel-setup")
from selenium.webdriver.common.keys import Keys

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def start_cell(launch: Callable[..., Any], out: Path, *arguments: str) -> tuple[Any, str]:
    """Start an emulated cell with its page; returns it and the page's address."""
    options = (f"out:={out}", "panel:=true", "record:=false", "speed:=max", *arguments)
    cell = launch("ros2", "launch", "softgrip_bringup", "cell.launch.yaml", *options)
    cell.wait_for("the page is at", 120.0)
    address = re.search(r"the page is at (http://127\.0\.0\.1:\d+)/", cell.output)
    assert address is not None
    return cell, address[1]


def log_in(browser: PanelBrowser, name: str = "Ada") -> None:
    browser.log_in(name)
    browser.wait(lambda: browser.text("#mode") in {"Idle", "Holding"}, "a cell that is up")


@pytest.mark.long
@pytest.mark.timeout(400)
def test_a_shift_by_clicks_only(launch: Callable[..., Any], tmp_path: Path) -> None:
    cell, address = start_cell(launch, tmp_path, "lift_window_s:=1.0")
    with PanelBrowser(address) as browser:
        log_in(browser)
        stop_and_reset(browser, cell)
        assert browser.measure_friction() >= 9
        swap(browser)
        grasp(browser)
    recorded = (tmp_path / "panel" / "acts.jsonl").read_text()
    assert re.search(r'"who": "Ada", "act": "estop", .*"success": true', recorded)
    cell.interrupt()
    cell.wait_for_end(30.0)
    # every act is in the cell's own audit table, too
    with Database(f"sqlite:///{tmp_path}/cell.db") as database:
        audited = {(one.who, one.action) for one in Library(database, lambda: 0).audit(1000)}
    assert {
        ("Ada", name)
        for name in ("estop", "calibrate", "activate_friction", "swap", "confirm_step", "grasp", "release")
    } <= audited


def stop_and_reset(browser: PanelBrowser, cell: Any) -> None:
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
    assert not browser.find("[data-name='reset']").is_enabled()  # nobody has control yet
    browser.press("take")
    browser.press("reset")
    browser.wait_for_text(".dialog", "The drives take hold where they stand")
    browser.press("reset-confirm")
    browser.wait(lambda: browser.text("#mode") == "Idle", "the end of the stop")


def swap(browser: PanelBrowser) -> None:
    """Mount the power hand; the emulated hands do what the page asks a person for."""
    browser.open("/swap")
    browser.press("swap-power")
    for word in ("open", "unhook", "insert", "close"):
        browser.wait(lambda word=word: word in browser.text("#instruction").lower(), f"an instruction to {word}")
        if word == "insert":
            browser.press("propose")
        browser.press("step-done")
    browser.wait_for_text("#instruction", "Done: ")
    curves = "return [...document.querySelectorAll('#check-curves li')].every(e => e.dataset.curve)"
    browser.wait(lambda: bool(browser.script(curves)), "the records of the mounted fingers")


def grasp(browser: PanelBrowser) -> None:
    """Plan one egg, run it, and look at what was kept of it."""
    browser.open("/work")
    browser.find("#orders textarea").send_keys("egg 1")
    browser.press("plan")
    browser.wait_for_text("#work-phase", "Planned")
    browser.press("work-start")
    browser.wait(lambda: browser.text("#work-phase") in {"Done", "Paused"}, "the end of the run")
    assert browser.text("#work-done") == "1 / 1", browser.text()
    browser.open("/grasps")
    browser.press("show-1")
    browser.wait_for_text("#grasp-detail", "egg: ")
    assert len(browser.script("return JSON.parse(document.getElementById('curve').dataset.curve).samples")) > 3
    browser.open("/")
    lines = "return document.getElementById('camera').dataset.lines || ''"
    browser.wait(lambda: browser.script(lines) == "measured predicted", "prediction and measurement over the picture")


#: Baloney is held by the power set alone, a grape by the pinch set alone: two swaps, whatever the order.
ORDERS = {"baloney": 1, "egg": 2, "orange": 1, "sausage": 1, "grape": 2}


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_whole_shift_by_clicks_from_a_list_with_two_swaps(launch: Callable[..., Any], tmp_path: Path) -> None:
    cell, address = start_cell(launch, tmp_path, "lift_window_s:=1.0", "record:=true")
    (tmp_path / "orders.csv").write_text(
        "product,quantity\n" + "".join(f"{name},{count}\n" for name, count in ORDERS.items())
    )
    with PanelBrowser(address) as browser:
        log_in(browser)
        browser.press("take")
        assert browser.measure_friction() >= 9
        browser.open("/work")
        browser.find("#orders input[type=file]").send_keys(str(tmp_path / "orders.csv"))
        browser.wait(lambda: "grape,2" in browser.find("#orders textarea").get_attribute("value"), "the file's orders")
        browser.press("plan")
        browser.wait_for_text("#work-phase", "Planned")
        assert browser.text("#plan-swaps") == "2"
        browser.press("work-start")
        assert sorted(run_until_the_end(browser)) == ["PI", "PW"]  # how the serials of pinch and power begin
        assert browser.text("#work-done") == f"{sum(ORDERS.values())} / {sum(ORDERS.values())}", browser.text()
        grasped = browser.text("#items tbody")
        assert all(name in grasped for name in ORDERS)
        a_grasp_of_another_client(browser, cell)
        a_bag(browser, tmp_path)
        browser.open("/")
        assert browser.text("#count-swaps") == "2"
    cell.interrupt()
    cell.wait_for_end(60.0)
    with Database(f"sqlite:///{tmp_path}/cell.db") as database:
        audited = {(one.who, one.action) for one in Library(database, lambda: 0).audit(1000)}
    acts_done = ("calibrate", "plan", "start_run", "swap", "confirm_step", "grasp", "release", "stop_recording")
    assert {("Ada", name) for name in acts_done} <= audited


def run_until_the_end(browser: PanelBrowser) -> list[str]:
    """Do what the run asks a person for, and go on where a product slipped; returns the sets that were mounted."""
    mounted: list[str] = []
    ends = {"Done", "Paused"}
    while True:
        browser.wait(
            lambda: browser.text("#work-phase") in ends or browser.find("#swap-waits").is_displayed(),
            "the end of the run, or a swap",
            180.0,
        )
        if browser.text("#work-phase") == "Done":
            return mounted
        if browser.find("#swap-waits").is_displayed():
            browser.find("#swap-waits").click()
            mounted.append(fingers_by_clicks(browser))
            browser.open("/work")
        else:
            browser.press("work-start")  # what did not hold is counted; the list goes on
            browser.wait(lambda: browser.text("#work-phase") != "Paused", "the run to go on")


def fingers_by_clicks(browser: PanelBrowser) -> str:
    """Do the steps of a swap that goes on; returns the set."""
    for word in ("open", "unhook", "insert", "close"):
        browser.wait(lambda word=word: word in browser.text("#instruction").lower(), f"an instruction to {word}")
        if word == "insert":
            browser.press("propose")
        browser.press("step-done")
    browser.wait(lambda: "Done: " in browser.text("#instruction"), "the end of the swap", 120.0)
    drawn = json.loads(str(browser.script("return document.getElementById('check').dataset.drawn || '{}'")))
    assert all(dots > 3 for _, dots in drawn.values()), drawn  # the empty closing was drawn as it went on
    browser.wait(lambda: browser.text("#unchecked") == "", "each finger's own record")
    return browser.text("#check-curves li").split()[-1].partition("-")[0]


def a_grasp_of_another_client(browser: PanelBrowser, cell: Any) -> None:
    """Let a terminal grasp: the page has its curve, its fingers and the sample that decided, from the cell."""
    browser.open("/grasps")
    before = int(browser.find("#grasps [data-name^='show-']").get_attribute("data-name").partition("-")[2])
    cell.ask("service", "call", "/emulator/place_object", "softgrip_interfaces/srv/PlaceObject", "{product: egg}")
    cell.ask("action", "send_goal", "/cell/grasp", "softgrip_interfaces/action/Grasp", "{product: egg}")
    browser.press(f"show-{before + 1}")
    browser.wait_for_text("#grasp-detail", "Fingers: ")
    browser.press(f"show-{before + 1}")
    browser.wait_for_text("#decided-after", "Decided ")
    assert json.loads(browser.find("#curve").get_attribute("data-curve"))["decided"] is not None
    browser.open("/")
    browser.press("release")
    browser.wait(lambda: browser.text("#mode") == "Idle", "the hand to be empty")


def a_bag(browser: PanelBrowser, folder: Path) -> None:
    """End the shift's bag by a click, replay it, and make its report."""
    browser.open("/bags")
    browser.press("stop")
    browser.wait(lambda: browser.count("#bags a[download]") > 0, "the bag")
    name = browser.text("#bags tbody th")
    browser.press(f"report-{name}")
    browser.wait(lambda: "Open the report" in browser.text("#bags"), "the report", 240.0)
    browser.press(f"replay-{name}")
    browser.wait(lambda: "identical: " in browser.text("#bags"), "the replay's verdict", 240.0)
    assert list(folder.rglob(f"{name}-report.html"))


@pytest.mark.long
@pytest.mark.timeout(500)
def test_a_swap_outlives_reload_second_browser_panel_and_manager(launch: Callable[..., Any], tmp_path: Path) -> None:
    port = free_port()
    cell, address = start_cell(launch, tmp_path, f"panel_port:={port}")
    with PanelBrowser(address) as browser, PanelBrowser(address) as second:
        log_in(browser)
        browser.open("/swap")
        browser.press("take")
        browser.press("swap-power")
        browser.wait_for_text("#instruction", "pen the palm")
        browser.driver.refresh()
        browser.wait_for_text("#instruction", "pen the palm")
        hand_over(browser, second)
        browser.wait_for_text("#instruction", "nhook")
        kill(cell, "panel")
        browser.wait(lambda: answers(port), "the panel to be back")
        log_in_again(browser)
        browser.wait_for_text("#instruction", "nhook")  # where it was, with the token of before
        browser.press("step-done")
        browser.wait_for_text("#instruction", "nsert")
        kill(cell, "grasp_mix_manager")
        browser.wait_for_text("#instruction", "Take your hands out of the cell")
        assert "locked: true" in safety(cell)
        browser.press("step-done")
        browser.wait_for_text("#instruction", "The swap has ended")
        browser.wait(lambda: browser.text("#mode") == "Idle", "the drives to be unlocked")
        assert "locked: false" in safety(cell)
        swap(browser)
    cell.interrupt()
    cell.wait_for_end(30.0)


def safety(cell: Any) -> str:
    """Return safety/state by the driver's own word."""
    return str(cell.ask("topic", "echo", "--once", "--qos-durability", "transient_local", "/safety/state"))


def hand_over(browser: PanelBrowser, second: PanelBrowser) -> None:
    """Let a second operator see the swap, ask for control, get it, and do a step."""
    log_in_again(second, "Bob", has_control=False)
    second.wait_for_text("#instruction", "pen the palm")
    assert not second.find("[data-name='step-done']").is_enabled()
    second.press("take")
    browser.wait_for_text("#control", "Bob asks for control")
    browser.press("hand_over")
    second.wait_for_text("#control", "You have control")
    assert not browser.find("[data-name='step-done']").is_enabled()
    second.press("step-done")


def log_in_again(browser: PanelBrowser, name: str = "Ada", *, has_control: bool = True) -> None:
    browser.log_in(name)
    browser.open("/swap")
    if has_control:
        browser.press("take")


def kill(cell: Any, node: str) -> None:
    """Kill a node and wait until it was started again."""
    killed = cell.node_process(node)
    os.kill(killed, signal.SIGKILL)
    deadline_s = time.monotonic() + 30.0
    while cell.node_process(node) in {None, killed}:
        assert time.monotonic() < deadline_s, f"{node} was not started again"
        time.sleep(0.05)


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.long
@pytest.mark.timeout(400)
def test_a_friction_measurement_outlives_the_panel_and_the_rig(launch: Callable[..., Any], tmp_path: Path) -> None:
    port = free_port()
    cell, address = start_cell(launch, tmp_path, f"panel_port:={port}")
    with PanelBrowser(address) as browser:
        log_in(browser)
        browser.open("/friction")
        browser.press("take")
        browser.press("rig-begin")
        measure_until(browser, 2)
        browser.wait(lambda: "3 / 9" in browser.text("#rig"), "the third point to be asked for")
        asked = browser.text("#rig-instruction")
        kill(cell, "panel")
        browser.wait(lambda: answers(port), "the panel to be back")
        browser.log_in("Ada")
        browser.open("/friction")
        browser.wait_for_text("#rig-instruction", asked)
        assert points(browser) == 2
        browser.press("take")
        measure_until(browser, 3)
        browser.press("cancel")  # the goal of a panel that is no more
        browser.wait_for_text("#rig-instruction", "CANCELLED")
        resume(browser)
        kill(cell, "friction_rig")
        browser.wait_for_text("#rig-instruction", "was broken off after 3 points: resume it")
        assert browser.count(POINT_ASKED) == 0
        resume(browser)
    cell.interrupt()
    cell.wait_for_end(30.0)


def points(browser: PanelBrowser) -> int:
    return browser.count("#rig-points tbody tr")


def measure_until(browser: PanelBrowser, count: int) -> None:
    """Do what the rig asks for until so many points are measured and the next is asked for."""
    while True:
        browser.wait(lambda: browser.count(POINT_ASKED) > 0, "a step that is asked for")
        if points(browser) == count:
            return
        before = browser.text("#rig-instruction")
        browser.press("rig-done")
        browser.wait(lambda before=before: browser.text("#rig-instruction") != before, "what follows")


def resume(browser: PanelBrowser) -> None:
    """Go on with the last plan; three of its points are measured."""
    if not browser.script("return document.querySelector('#rig-start .q-checkbox').ariaChecked === 'true'"):
        browser.find("#rig-start .q-checkbox").click()
    browser.press("rig-begin")
    browser.wait_for_text("#rig-instruction", "the gauge is set to zero")
    browser.press("rig-done")
    browser.wait(lambda: "4 / 9" in browser.text("#rig"), "the fourth point to be asked for")


@pytest.mark.long
@pytest.mark.timeout(400)
def test_setting_up_by_clicks_does_what_ros2_does(launch: Callable[..., Any], tmp_path: Path) -> None:
    cell, address = start_cell(launch, tmp_path)
    with PanelBrowser(address) as browser:
        log_in(browser)
        browser.open("/setup")
        browser.wait_for_text("#driver-phase", "tendons held")
        browser.press("take")
        bed_in(browser)
        free_and_take_back(browser, cell)
        set_a_parameter(browser, cell)
    cell.interrupt()
    cell.wait_for_end(30.0)


def bed_in(browser: PanelBrowser) -> None:
    """Tension until the zeros of the emulated tendons stay."""
    for number in range(1, 6):
        browser.press("tension")
        browser.wait_for_text("#tensioning tbody tr", str(number))
        if "The zeros stay" in browser.text("#tensioning-said"):
            return
    raise AssertionError(f"expected zeros that stay within 5 rounds, found {browser.text('#tensioning tbody')}")


def free_and_take_back(browser: PanelBrowser, cell: Any) -> None:
    browser.press("free-bus")
    browser.press("free-confirm")
    browser.wait_for_text("#bus-owner", "The bus is free")
    assert "unconfigured" in cell.ask("lifecycle", "get", "/tendon_driver")
    browser.press("take-bus")
    browser.press("take-confirm")
    browser.wait_for_text("#driver-phase", "tendons held")
    assert "active" in cell.ask("lifecycle", "get", "/tendon_driver")


def set_a_parameter(browser: PanelBrowser, cell: Any) -> None:
    browser.wait(lambda: browser.count("#parameters option[value='camera']") == 1, "the cell's nodes")
    browser.find("#parameters option[value='camera']").click()
    browser.press("read-parameters")
    browser.press("set-jpeg_quality")
    field = browser.find(".new-value input")
    field.send_keys(Keys.CONTROL, "a")
    field.send_keys("70")
    browser.press("set-confirm")
    browser.wait_for_text("#parameters tbody", "70")
    assert "70" in cell.ask("param", "get", "/camera", "jpeg_quality")
