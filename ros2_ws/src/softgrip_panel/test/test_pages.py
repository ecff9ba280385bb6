# SPDX-License-Identifier: Apache-2.0
"""The pages in a real Chromium, by clicks and keys only, on a cell that answers at once."""

from __future__ import annotations

import json
import re
from typing import Any
from urllib.parse import quote

import pytest

from softgrip_testing.browser import PanelBrowser

pytest.importorskip("nicegui", reason="make panel-setup")
pytest.importorskip("selenium", reason="make panel-setup")
from selenium.webdriver.common.keys import Keys

from softgrip_panel.web.shell import PAGES

pytestmark = pytest.mark.slow

#: What panel_site gives for a product, a serial, a value, a folder.
HOSTILE = "<img src=x onerror=window.hacked=1>"
#: conftest's
RunningSite = Any


def take_control(browser: PanelBrowser) -> None:
    browser.wait(lambda: browser.text("#control") != "", "the owner of control")
    if browser.text("#control") != "You have control":
        browser.press("take")
        browser.wait_for_text("#control", "You have control")


def wait_for_pictures(browser: PanelBrowser, count: int) -> None:
    """Wait until so many more pictures have come."""
    number = "return Number(document.getElementById('camera').dataset.number || 0)"
    last = int(browser.script(number)) + count
    browser.wait(lambda: browser.script(number) >= last, "pictures")


def test_opening_pages_moves_and_powers_nothing(browser: PanelBrowser, site: RunningSite) -> None:
    for path in PAGES:
        browser.open(path)
        browser.wait(lambda: browser.script("return !document.body.classList.contains('disconnected')"), "live data")
    assert site.calls() == []


def test_stop_by_one_click_and_back_by_an_owner_of_control(browser: PanelBrowser, site: RunningSite) -> None:
    browser.open("/")
    browser.find("#estop").click()
    browser.wait_for_text("#estop-said", "stopped (let_go)")
    browser.wait_for_text("#mode", "Emergency stop")
    browser.wait_for_text("#alarms", "make the cell safe, then estop_reset")  # from the driver's fault table
    for path in PAGES:
        browser.open(path)
        browser.wait_for_text("#alarm-count", "Alarms: 1")
        assert not browser.find("#swap-waits").is_displayed()
    browser.find("#alarm-count").click()
    browser.wait_for_text("#alarms", "make the cell safe, then estop_reset")
    assert not browser.find("[data-name='reset']").is_enabled()
    take_control(browser)
    browser.press("reset")
    browser.wait_for_text(".dialog", "asked for through the service estop")
    browser.press("reset-confirm")
    browser.wait_for_text("#mode", "Idle")
    browser.press("acknowledge")
    browser.wait_for_text("#alarms", "No alarms")
    assert not browser.find("#alarm-count").is_displayed()
    assert [one["act"] for one in site.calls()] == ["estop", "estop_reset"]
    assert {one["who"] for one in site.calls()} == {"Ada"}


def test_a_grasp_by_clicks_and_what_is_kept_of_it(browser: PanelBrowser, site: RunningSite) -> None:
    browser.open("/")
    take_control(browser)
    assert "What is held falls" in browser.text("#release-hint")
    browser.press("hold")
    browser.wait_for_text("#mode", "Holding")
    browser.open("/fingers")
    browser.wait_for_text("#residuals", "not judged while holding")
    assert browser.script("return document.querySelectorAll('#residuals .good').length") == 0
    browser.open("/")
    browser.wait_for_text("#count-gripped", "1")
    browser.press("release")
    browser.wait_for_text("#mode", "Idle")
    browser.open("/grasps")
    browser.press("show-1")
    browser.wait_for_text("#grasp-detail", "both sides press")
    browser.wait(
        lambda: browser.script("return document.querySelector('.pictures img').naturalWidth") == 640, "a picture"
    )
    export = "return fetch(document.getElementById('export').href).then(answer => answer.text())"
    assert len(browser.script(export).splitlines()) == 3  # its heading and both grasps
    browser.press("show-counted-1700000000")  # of another client, before this panel was there
    browser.wait_for_text("#grasp-detail", "nothing between the fingers")
    browser.wait_for_text("#grasp-detail", "Fingers: pinch PI-I-07, PI-M-07, PI-T-07")
    browser.wait_for_text("#decided-at", "0.8 s before it was counted")
    assert "contact tension 3.1 N" in browser.text("#grasp-detail")
    browser.find("#grasps input").send_keys("orange")
    browser.wait(lambda: len(browser.script(export).splitlines()) == 1, "an export by the filter")
    browser.open("/fingers")
    browser.wait_for_text("#contacts", "at the last verdict: BLOCKED")
    browser.wait(lambda: "not judged" not in browser.text("#residuals"), "a verdict of an empty finger")
    assert browser.script("return document.querySelectorAll('#residuals .good').length") == 0  # it learns


def test_an_order_list_is_planned_run_and_counted(browser: PanelBrowser, site: RunningSite) -> None:
    browser.open("/work")
    take_control(browser)
    area = browser.find("#orders textarea")
    area.send_keys("egg 2\nnonsense, x")
    browser.press("plan")
    browser.wait_for_text("#order-problem", "line 2")
    (site.folder / "orders.csv").write_text("product,quantity\negg,2\ngrape,1\n")
    browser.find("#orders input[type=file]").send_keys(str(site.folder / "orders.csv"))
    browser.wait(lambda: area.get_attribute("value") == "product,quantity\negg,2\ngrape,1\n", "the file's orders")
    browser.press("plan")
    browser.wait_for_text("#work-phase", "Planned")
    browser.press("work-start")
    browser.wait_for_text("#work-phase", "Done")
    assert browser.text("#work-done") == "3 / 3"
    assert browser.text("#work-gripped") == "3"
    grasped = [one["request"]["product"] for one in site.calls() if one["act"] == "grasp"]
    assert grasped[-3:] == ["egg", "egg", "grape"]


def test_a_product_that_is_always_refused_is_left_out(browser: PanelBrowser, site: RunningSite) -> None:
    browser.open("/work")
    take_control(browser)
    assert not browser.find("[data-name='work-leave-out']").is_displayed()
    browser.find("#orders textarea").send_keys("orange 1\negg 1")
    browser.press("plan")
    browser.wait_for_text("#work-phase", "Planned")
    browser.press("work-start")
    browser.wait_for_text("#work-phase", "Paused")
    browser.wait_for_text("[data-name='work-leave-out']", "Leave out orange")
    browser.press("work-leave-out")
    browser.wait_for_text("#items", "left out by Ada: TENDON_FAULT: index: no reply")
    browser.press("work-start")
    browser.wait_for_text("#work-phase", "Done")
    assert browser.text("#work-done") == "1 / 1"
    assert [(one["who"], one["success"]) for one in site.recorded() if one["act"] == "leave_out"] == [("Ada", True)]


def test_a_users_own_finger_set_is_mounted_by_its_button(browser: PanelBrowser, site: RunningSite) -> None:
    browser.open("/swap")
    take_control(browser)
    browser.press("swap-my_pinch")
    browser.wait_for_text("#instruction", "Open the palm.")
    swaps = [one["request"]["finger_set"] for one in site.calls() if one["act"] == "swap"]
    assert swaps == ["my_pinch"]
    assert len(browser.script("return [...document.querySelectorAll('.drawing .slot')]")) == len(("i", "m", "t"))
    browser.press("swap-cancel")
    browser.wait_for_text("#instruction", "CANCELLED")


def closings(browser: PanelBrowser) -> dict[str, tuple[int, int]]:
    """Return of each slot how many points of its record, and how many dots of now, page Swap has drawn."""
    return dict(json.loads(str(browser.script("return document.getElementById('check').dataset.drawn || '{}'"))))


def check_colours(browser: PanelBrowser) -> list[int]:
    """Return how many pixels of the check have the colour of records, and that of now."""
    return list(
        browser.script(
            "const c = document.getElementById('check'), s = getComputedStyle(document.body);"
            "const rgb = n => [1, 3, 5].map(k => parseInt(s.getPropertyValue(n).trim().slice(k, k + 2), 16));"
            "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            "return ['--measured', '--accent'].map(n => { const w = rgb(n); let found = 0;"
            "for (let k = 0; k < d.length; k += 4)"
            " if (d[k + 3] > 250 && w.every((v, j) => Math.abs(v - d[k + j]) < 3)) found += 1; return found; });"
        )
    )


def test_a_swap_survives_reload_and_a_second_browser_and_takes_scanned_serials(
    browser: PanelBrowser, site: RunningSite
) -> None:
    browser.open("/swap")
    take_control(browser)
    browser.press("swap-pinch")
    browser.wait_for_text("#instruction", "Open the palm.")
    browser.open("/records")
    browser.wait_for_text("#swap-waits", "A swap waits for you")
    browser.find("#swap-waits").click()
    browser.wait_for_text("#instruction", "Open the palm.")
    browser.driver.refresh()
    browser.wait_for_text("#instruction", "Open the palm.")
    browser.wait(lambda: all(record > 10 and dots > 10 for record, dots in closings(browser).values()), "closings")
    assert set(closings(browser)) == {"index", "middle", "thumb"}
    assert min(check_colours(browser)) > 50  # the records' lines, and the dots of now
    assert browser.text("#unchecked") == ""
    browser.press("step-done")
    browser.wait_for_text("#instruction", "Do remove.")
    with PanelBrowser(site.address) as second:
        second.log_in("Bob")
        second.open("/swap")
        second.wait_for_text("#instruction", "Do remove.")
        assert not second.find("[data-name='step-done']").is_enabled()  # it is Ada's
        second.press("take")
        browser.wait_for_text("#control", "Bob asks for control")
        browser.press("hand_over")
        second.wait_for_text("#control", "You have control")
        second.press("step-done")
        second.wait_for_text("#instruction", "Do insert.")
        second.press("give_back")
    browser.wait_for_text("#instruction", "Do insert.")
    take_control(browser)
    field = browser.find(".serials input")
    for serial in ("PI-I-01", "PI-M-01"):
        field.send_keys(serial + "\n")  # a scanner types and ends with Enter
    browser.press("step-done")
    browser.wait_for_text("#swap-problem", "missing for: thumb")
    field.send_keys("PI-T-01\n")
    browser.wait_for_text("#instruction", "Do close_palm.")
    browser.press("step-done")
    browser.wait_for_text("#instruction", "Done: every finger is as its record says")
    insert = next(one for one in site.calls() if one["act"] == "confirm_step" and one["request"]["serials"])
    assert insert["request"]["serials"] == ["PI-I-01", "PI-M-01", "PI-T-01"]
    who = [one["who"] for one in site.calls() if one["act"] == "confirm_step"]
    assert who == ["Ada", "Bob", "Ada", "Ada"]


def test_a_swap_of_another_client_is_followed_and_only_its_owner_confirms(
    browser: PanelBrowser, site: RunningSite
) -> None:
    def others_are_at(words: str) -> None:
        (site.folder / "foreign_swap.part").write_text(words)
        (site.folder / "foreign_swap.part").rename(site.folder / "foreign_swap")

    confirmed = [one["act"] for one in site.calls()].count("confirm_step")
    browser.open("/records")
    take_control(browser)
    others_are_at("insert")
    browser.wait_for_text("#swap-waits", "A swap of another client waits for a person")
    browser.find("#swap-waits").click()
    browser.wait_for_text("#instruction", "Others do insert.")
    browser.wait_for_text("#swap-foreign", "Only it has the token")
    assert browser.text("#swap-clock").startswith("1:")
    for name in ("step-done", "propose"):
        assert not browser.find(f"[data-name='{name}']").is_displayed()
    assert not browser.find(".serials input").is_displayed()
    assert browser.find("[data-name='swap-cancel']").is_displayed()  # ending a motion is everybody's who operates
    assert not browser.find("[data-name='swap-power']").is_enabled()
    others_are_at("verify")
    browser.wait_for_text("#instruction", "Others do verify.")
    browser.wait(lambda: not browser.find("#swap-waits").is_displayed(), "nothing to wait for")
    others_are_at("hands_out")
    browser.wait_for_text("#instruction", "have whoever ordered it confirm that")
    assert not browser.find("[data-name='step-done']").is_displayed()
    others_are_at("done")
    browser.wait_for_text("#instruction", "Done: every finger is as its record says")
    browser.wait(lambda: browser.find("[data-name='swap-power']").is_enabled(), "a swap can be begun")
    assert [one["act"] for one in site.calls()].count("confirm_step") == confirmed


def test_a_friction_measurement_by_clicks_is_accepted_with_a_reason(browser: PanelBrowser, site: RunningSite) -> None:
    browser.open("/friction")
    take_control(browser)
    browser.press("rig-begin")
    browser.wait_for_text("#rig-instruction", "hang 0.50 kg")
    browser.wait_for_text("#rig-waits", "A measurement waits for you")
    assert "90 deg, 0.50 kg" in browser.script(
        "return document.querySelector('.drawing svg').getAttribute('aria-label')"
    )
    browser.press("rig-done")
    browser.wait_for_text("#rig-instruction", "hang 1.00 kg")
    browser.press("rig-done")
    browser.wait_for_text("#rig-instruction", "SUCCEEDED")
    assert browser.text("#rig-points").count("1.244") == 2  # 12.2 / 9.81
    browser.wait_for_text("#fit-model", "braid-new: USABLE")
    parts = "return ['fitted', 'band', 'measured'].map(c => document.querySelectorAll(`#friction-fit .${c}`).length)"
    assert browser.script(parts) == [2, 2, 2]  # a curve with its interval for each load, and both points
    refuse_the_fit(browser, site)
    browser.press("activate-braid-new")
    browser.wait_for_text(".dialog", "refused by Ada: the cable was frayed")

    def refused() -> bool:  # a press while the dialog is still opening is lost
        browser.press("activate-confirm")
        return "expected some words" in browser.text(".dialog")

    browser.wait(refused, "a reason asked for")
    browser.find(".activate-reason input").send_keys("fresh cable")
    browser.press("activate-confirm")
    browser.wait(lambda: site.recorded()[-1]["act"] == "activate_friction", "the activation")
    assert site.recorded()[-1]["subject"] == "braid-new: fresh cable"
    browser.wait(lambda: "refused by" not in browser.text("#friction-models"), "the refusal to be lifted")


def refuse_the_fit(browser: PanelBrowser, site: RunningSite) -> None:
    """Refuse the model that was fitted: it stays, with name and reason, and the active one stays active."""
    browser.press("refuse")

    def asked() -> bool:  # a press while the dialog is still opening is lost
        browser.press("refuse-confirm")
        return "expected some words" in browser.text(".dialog")

    browser.wait(asked, "a reason asked for")
    browser.find(".refuse-reason input").send_keys("the cable was frayed")
    browser.press("refuse-confirm")
    browser.wait_for_text("#friction-models", "refused by Ada: the cable was frayed")
    browser.wait(lambda: not browser.find("[data-name='accept']").is_displayed(), "nothing left to judge")
    (asked_for,) = (one["request"] for one in site.calls() if one["act"] == "refuse_friction")
    assert asked_for == {
        "who": "Ada", "action": "refuse friction model", "subject": "braid-new", "detail": "the cable was frayed",
    }  # fmt: skip
    assert [one["act"] for one in site.calls()].count("activate_friction") == 0


def test_a_finger_is_retired_with_a_reason_and_its_label_carries_its_serial(
    browser: PanelBrowser, site: RunningSite
) -> None:
    browser.open("/records")
    browser.press("retire-PW-T-02")
    command = "const code = document.querySelector('.dialog code'); return code ? code.textContent : ''"
    browser.wait(lambda: "ros2 service call /cell/retire_finger" in browser.script(command), "the same as a command")
    browser.find(".retire-reason input").send_keys("tore at joint 2")
    browser.press("retire-confirm")
    browser.wait_for_text("[data-serial='PW-T-02']", "retired")
    call = next(one for one in site.calls() if one["act"] == "retire_finger")
    assert call["request"] == {"serial": "PW-T-02", "who": "Ada", "reason": "tore at joint 2"}
    browser.driver.get(site.address + "/label/PW-T-02")
    assert "PW-T-02" in browser.text()
    assert browser.count("svg path") > 0


def test_the_check_of_a_finger_is_drawn_in_its_record(browser: PanelBrowser) -> None:
    browser.open("/records")
    browser.press("check-PW-M-01")
    browser.wait_for_text(".dialog", "Empty closing of PW-M-01")
    assert browser.count(".dialog path.check") == 1
    assert browser.accessibility() == []
    browser.press("check-close")


def test_statistics_of_a_finger_are_drawn_with_the_limits_that_decide(browser: PanelBrowser) -> None:
    browser.open("/fingers")
    browser.wait_for_text("#watch-limits", "watched from 2.5 on, decided about from 5 on")
    browser.wait(lambda: browser.count("#residual-charts .statistic") == 2, "friction and stiffness")
    assert browser.count("#residual-charts .limit") == 2
    assert browser.count("#residual-charts .tip") == 1


def test_a_finger_is_drawn_with_every_face_coloured_by_its_strain(browser: PanelBrowser) -> None:
    browser.open("/fingers")
    drawn = "const c = document.getElementById('shape'); return [Number(c.dataset.number || 0), c.dataset.coloured]"
    browser.wait(lambda: browser.script(drawn)[0] > 2, "a shape")
    assert browser.script(drawn)[1] == "true"
    assert browser.script("return getComputedStyle(document.getElementById('shape')).touchAction") == "none"
    browser.wait_for_text("#shape-said", "0 .. 20.0 %")
    colours = browser.script(
        "const c = document.getElementById('shape');"
        "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        "let [blue, red] = [0, 0]; for (let k = 0; k < d.length; k += 4) { if (d[k + 3] < 200) continue;"
        "if (d[k + 2] > d[k] + 60) blue += 1; if (d[k] > d[k + 2] + 60) red += 1; } return [blue, red];"
    )
    assert min(colours) > 200  # the base is blue, the tip is red


def test_a_bag_is_begun_ended_reported_replayed_and_fetched(browser: PanelBrowser, site: RunningSite) -> None:
    browser.open("/bags")
    take_control(browser)
    assert re.search(r"[0-9] [GT]B left on the disk", browser.text("#free"))
    before = len(site.calls())
    for name in ("start", "split", "stop", "snapshot"):
        browser.press(name)
    recorder = ["start_recording", "split_recording", "stop_recording", "snapshot"]
    browser.wait(lambda: [one["act"] for one in site.calls()[before:]] == recorder, "what the recorder was told")
    browser.wait_for_text("#bags", "part_0.mcap (4 kB)")
    browser.press("replay-softgrip_20261125")
    browser.wait_for_text("#bags", "identical: messages: 120, largest: 0.0")
    browser.press("report-softgrip_20261125")
    browser.wait_for_text("#bags", "Open the report")
    said = (site.folder / "said").read_text()
    assert "softgrip_bag replay --through kinematics_predictor --json" in said
    fetched = "return fetch(document.querySelector('#bags a[download]').href).then(a => a.text()).then(t => t.length)"
    assert browser.script(fetched) == 4000
    browser.driver.get(browser.find("#bags a[href$='/report']").get_attribute("href"))
    assert browser.text() == "a report"
    assert browser.count("svg path") == 1
    assert [one["subject"] for one in site.recorded() if one["act"] in {"report", "replay"}] == [
        "softgrip_20261125", "softgrip_20261125",
    ]  # fmt: skip


# --- set-up


def test_the_bus_is_freed_for_a_terminal_and_taken_back(browser: PanelBrowser, site: RunningSite) -> None:
    browser.open("/setup")
    take_control(browser)
    browser.wait_for_text("#driver-phase", "tendons held")
    browser.wait_for_text("#driver", "Replies are lost")  # three of them, says the driver
    browser.wait_for_text("#bus-owner", "The driver has the bus")
    assert "wizard --port /dev/servos --tendons index middle thumb --file cell.yaml" in browser.text("#terminal")
    browser.press("free-bus")
    browser.wait_for_text(".dialog", "What the hand holds falls")
    for key in ("scan", "ids", "selftest"):
        assert not browser.find(f"[data-name='run-{key}']").is_enabled()  # the driver has the bus
    browser.press("free-confirm")
    browser.wait_for_text("#bus-owner", "The bus is free")
    run_on_the_bus(browser, site)
    browser.press("take-bus")
    browser.press("take-confirm")
    browser.wait_for_text("#driver-phase", "tendons held")
    asked = [one["request"]["transition"]["label"] for one in site.calls() if one["act"] == "set_driver"]
    assert asked == ["deactivate", "cleanup", "configure", "activate"]


def run_on_the_bus(browser: PanelBrowser, site: RunningSite) -> None:
    """Scan, test and name servos by clicks; what the commands say is shown."""
    browser.press("run-scan")
    browser.wait_for_text("#bench-said", "Scan: running")
    assert not browser.find("[data-name='take-bus']").is_enabled()  # not into the midst of it
    browser.driver.refresh()  # it goes on, and what it says is shown
    browser.wait_for_text("#bench-output", "ID 1: XL330-M288 at 1000000 baud")
    browser.wait_for_text("#bench-said", "Scan: done")
    browser.press("run-selftest")
    browser.wait_for_text("#bench-output", "fix: set it to 1 ms")
    browser.wait_for_text("#bench-said", "Self-test: ended with code 1")
    field = browser.find(".id-new input")
    field.send_keys(Keys.CONTROL, "a")
    field.send_keys("3\t")
    browser.press("run-ids")
    browser.wait_for_text("#bench-said", "One servo's ID and baud rate: done")
    assert browser.count("[data-name='run-wizard'], [data-name='run-calibrate']") == 0
    asked = [line for line in (site.folder / "said").read_text().splitlines() if "softgrip_driver" in line]
    assert asked == [
        "run softgrip_driver scan --port /dev/servos",
        "run softgrip_driver selftest --port /dev/servos --baud 1000000",
        "run softgrip_driver setup --port /dev/servos --baud 57600 --id 1 --new-id 3 --new-baud 1000000",
    ]
    browser.resize(1280, 2400)
    browser.screenshot(site.folder / "setup.png")
    browser.resize(1280, 800)


def test_tendons_are_bedded_in_until_no_zero_moves(browser: PanelBrowser, site: RunningSite) -> None:
    browser.open("/setup")
    take_control(browser)
    browser.press("tension")
    browser.wait_for_text("#tensioning tbody", "index +0.50 mm")
    browser.wait_for_text("#tensioning-said", "Do another round")
    browser.press("tension")
    browser.wait_for_text("#tensioning-said", "The zeros stay")
    moves = [one["request"] for one in site.calls() if one["act"] in {"pull", "slacken"}]
    assert [(one["mode"], one["targets"]) for one in moves] == [(2, [5.0]), (1, [0.0])] * 2


def test_a_weight_is_weighed_and_one_that_swings_is_not(browser: PanelBrowser) -> None:
    browser.open("/setup")
    browser.wait(lambda: browser.count("#weights option") == 3, "the tendons")
    browser.press("weigh")  # the site's tensions never rest
    browser.wait_for_text("#weight-problem", "expected a weight at rest")


def test_a_lens_is_found_from_views_and_given_to_the_camera(
    browser: PanelBrowser, site: RunningSite, board_pictures: list[bytes]
) -> None:
    browser.open("/setup")
    take_control(browser)
    browser.press("take-view")
    browser.wait_for_text("#view-problem", "expected the board of 11 x 7 squares")
    browser.press("find-lens")
    browser.wait_for_text("#views", "at least 8 different views")
    shown = site.folder / "shown.jpg"
    for number, jpeg in enumerate(board_pictures, 1):
        part = shown.with_suffix(".part")
        part.write_bytes(jpeg)
        part.replace(shown)
        wait_for_pictures(browser, 2)
        browser.press("take-view")
        browser.wait_for_text("#views", f"Views: {number}")
    browser.press("find-lens")
    browser.wait_for_text("#views", "Lens found from")
    browser.press("use-lens")
    browser.wait(lambda: any(one["act"] == "set_camera_info" for one in site.calls()), "the lens at the camera")
    shown.unlink()
    (given,) = (one["request"]["camera_info"] for one in site.calls() if one["act"] == "set_camera_info")
    assert given["k"][0] == pytest.approx(905.0, rel=0.01)  # what the pictures were drawn with
    assert len(list((site.folder / "views").glob("view_*.jpg"))) == len(board_pictures)


def test_a_parameter_is_set_within_its_bounds_only(browser: PanelBrowser, site: RunningSite) -> None:
    browser.open("/setup")
    take_control(browser)
    browser.press("read-parameters")
    browser.wait_for_text("#parameters", "50 .. 100")
    assert browser.count("[data-name='set-source']") == 0  # at start only
    browser.press("set-jpeg_quality")
    field = browser.find(".new-value input")
    field.send_keys(Keys.CONTROL, "a")
    field.send_keys("101")

    def refused() -> bool:  # a press while the dialog is still opening is lost
        browser.press("set-confirm")
        return "expected 50 .. 100, found 101" in browser.text(".dialog")

    browser.wait(refused, "the bounds")
    field.send_keys(Keys.CONTROL, "a")
    field.send_keys("80")
    browser.press("set-confirm")
    browser.wait(lambda: "80" in browser.text("#parameters tbody tr td"), "the new value")
    (setting,) = next(one["request"]["parameters"] for one in site.calls() if one["act"] == "set_parameter")
    assert setting == {"name": "jpeg_quality", "value": {"type": 2, "integer_value": 80}}


def test_a_hostile_name_is_text_and_nothing_else(browser: PanelBrowser, site: RunningSite) -> None:
    for path in PAGES:
        browser.open(path)
        browser.wait(lambda: browser.script("return !document.body.classList.contains('disconnected')"), "live data")
        assert browser.script("return window.hacked === undefined && !document.querySelector('img[src=x]')")
    browser.open("/work")
    browser.wait_for_text("#products", HOSTILE)
    browser.open("/records")
    browser.wait_for_text("#records", HOSTILE)  # a serial
    browser.open("/setup")
    browser.press("read-parameters")
    browser.wait_for_text("#parameters", HOSTILE)  # a value
    browser.open("/bags")
    browser.wait_for_text("#bags", "softgrip_20261125")
    assert HOSTILE not in browser.text("#bags")  # no name that a bag may have
    browser.driver.get(f"{site.address}/label/{quote(HOSTILE, safe='')}")
    browser.wait_for_text("strong", HOSTILE)
    assert browser.script("return window.hacked === undefined")


def test_a_file_that_is_too_large_never_leaves_the_browser(browser: PanelBrowser, site: RunningSite) -> None:
    browser.open("/work")
    (site.folder / "large.csv").write_text("egg,1\n" * 20_000)
    browser.find("#orders input[type=file]").send_keys(str(site.folder / "large.csv"))
    browser.wait_for_text("#order-problem", "at most 64 KiB")
    assert browser.find("#orders textarea").get_attribute("value") == ""


def test_no_request_leaves_the_machine(browser: PanelBrowser, site: RunningSite) -> None:
    browser.requested()  # those of the tests before
    own = (site.address, site.address.replace("http", "ws"))
    for path in (*PAGES, "/login", "/label/PW-I-01"):
        browser.driver.get(site.address + path)
        if path in PAGES:
            browser.wait(
                lambda: browser.script("return !document.body.classList.contains('disconnected')"), "live data"
            )
        asked = browser.requested()
        assert any(path in url for url in asked)
        assert any("/live" in url for url in asked) is (path in PAGES), path
        assert [url for url in asked if not url.startswith(own)] == []


def clipped(browser: PanelBrowser) -> list[str]:
    """Return the tables of which something is to be seen only after scrolling sideways."""
    code = (
        "const wide = e => e.offsetParent && e.scrollWidth > e.clientWidth + 1;"
        "const said = e => `${e.innerText.slice(0, 300)}: ${e.scrollWidth} px in ${e.clientWidth}`;"
        "return [...document.querySelectorAll('.scroll')].filter(wide).map(said)"
    )
    return [str(one) for one in browser.script(code)]


@pytest.mark.parametrize("path", PAGES)
def test_a_page_fits_every_screen_and_axe_finds_nothing_serious(browser: PanelBrowser, path: str) -> None:
    browser.open(path)
    for width, height in ((820, 1180), (1920, 1080), (1280, 800)):
        browser.resize(width, height)
        assert browser.script("return document.documentElement.scrollWidth <= window.innerWidth + 1"), (width, height)
        assert clipped(browser) == [], (width, height)
    small = browser.script(
        "return [...document.querySelectorAll('button, nav a')].filter(e => e.offsetParent && e.offsetHeight < 44"
        ").map(e => e.innerText)"
    )
    assert small == []  # for gloves
    for theme in ("--light", "--dark"):
        if not browser.script("return document.body.classList.contains(arguments[0])", f"body{theme}"):
            browser.find("#theme").click()
        assert browser.accessibility() == []
    browser.find("#theme").click()


def test_a_chosen_theme_stays_on_every_page(browser: PanelBrowser) -> None:
    browser.open("/")
    for _ in range(2):  # dark, then light again for the tests that follow
        chosen = browser.script("return document.body.classList.contains('body--dark') ? 'body--light' : 'body--dark'")
        browser.find("#theme").click()
        for path in PAGES:
            browser.open(path)
            browser.wait(
                lambda: browser.script("return !document.body.classList.contains('disconnected')"), "live data"
            )
            assert chosen in browser.script("return document.body.className"), path


@pytest.mark.parametrize(("name", "role"), [("Eve", "looks only"), ("Ada", "operates")])
def test_every_page_in_a_smaller_role_has_only_what_that_role_may(
    guarded_site: RunningSite, name: str, role: str
) -> None:
    before = len(guarded_site.calls())
    with PanelBrowser(guarded_site.address) as browser:
        browser.log_in(name, f"{name} has one")
        for path in PAGES:
            browser.open(path)
            browser.wait_for_text("#who", f"{name} ({role})")
            assert (browser.count("[data-name='take']") == 1) is (name == "Ada")
            assert browser.count("[data-name='force'], [data-name^='retire-'], [data-name='free-bus']") == 0
            if name == "Eve":
                # whatever there is, is pressed
                browser.script(
                    "for (const one of document.querySelectorAll('main .act')) if (one.offsetParent) one.click()"
                )
                assert browser.accessibility() == []
    assert len(guarded_site.calls()) == before


def test_a_wrong_password_is_said_and_lets_nobody_in(guessed_site: RunningSite) -> None:
    with PanelBrowser(guessed_site.address) as browser:
        browser.log_in("Ada", "a guess")
        browser.wait_for_text(".problem", "Name or password is wrong.")
        assert browser.count("#estop") == 0
        assert browser.accessibility() == []
        browser.driver.get(guessed_site.address + "/setup")
        browser.wait(lambda: browser.count("#password") == 1, "the log-in")
        browser.log_in("Ada", "Ada has one")
        browser.wait_for_text("#who", "Ada (operates)")


@pytest.mark.parametrize("dark", ["dark", "light"])
def test_axe_finds_nothing_serious_on_the_log_in(guarded_site: RunningSite, site: RunningSite, dark: str) -> None:
    for address in (guarded_site.address, site.address):  # with passwords and without
        with PanelBrowser(address) as browser:
            theme = {"name": "prefers-color-scheme", "value": dark}
            browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [theme]})
            browser.driver.get(address + "/login")
            browser.find("#name")
            assert browser.accessibility() == []


def test_the_stop_is_the_first_thing_that_the_keyboard_reaches_after_the_skip_link(browser: PanelBrowser) -> None:
    browser.open("/")
    body = browser.find("body")
    body.send_keys(Keys.TAB)
    assert browser.script("return document.activeElement.className") == "skip"
    browser.driver.switch_to.active_element.send_keys(Keys.TAB)
    assert browser.script("return document.activeElement.id") == "estop"
    browser.driver.switch_to.active_element.send_keys(Keys.ENTER)
    browser.wait_for_text("#estop-said", "stopped")
