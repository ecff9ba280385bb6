# SPDX-License-Identifier: Apache-2.0
"""The panel's site with a cell that is none: runs as a process for the browser tests, `python panel_site.py [FILE...]`.

It says its address on the first line. Acts change the state as a cell would; what was called stands in `calls`.
"""

from __future__ import annotations

import asyncio
import json
import math
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np

from softgrip_panel.access.accounts import Accounts
from softgrip_panel.access.origin import OriginRule
from softgrip_panel.access.record import ActRecord
from softgrip_panel.access.sessions import LoginBrake, Sessions
from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.bags import BagFolder, BagJobs
from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.facts import (
    CellView,
    FingerRecordView,
    MountedView,
    OwnerView,
    ProductView,
    SafetyView,
    StopPolicyView,
    TendonView,
    TensionView,
)
from softgrip_panel.model.frames import PanelPicture
from softgrip_panel.model.state import PanelState
from softgrip_panel.model.swap import STEPS
from softgrip_panel.model.work import Worker, WorkRun
from softgrip_panel.texts import Texts
from softgrip_panel.web.pages.every import add_pages
from softgrip_panel.web.server import WebServer, listen
from softgrip_panel.web.site import PanelSite

SLOTS = ("index", "middle", "thumb")
#: A name that an attacker would give a product.
HOSTILE = "<img src=x onerror=window.hacked=1>"


class PretendedCell:
    """Answers acts at once; keeps what was asked for."""

    def __init__(self, state: PanelState, file: Path) -> None:
        self.state = state
        self._file = file
        self.serials: list[str] = []

    async def call(self, act: Act, who: str) -> ActResult:
        with self._file.open("a") as out:
            out.write(json.dumps({"act": act.name, "who": who, "request": dict(act.call.request)}) + "\n")
        await asyncio.sleep(0.01)
        answer = getattr(self, f"_{act.name}", None)
        return answer(act, who) if answer else ActResult(success=True, message="done")

    def cancel(self, act_name: str) -> None:
        with self._file.open("a") as out:
            out.write(json.dumps({"act": f"cancel {act_name}"}) + "\n")

    def _estop(self, act: Act, who: str) -> ActResult:
        self.state.observe_safety(SafetyView(estop=True, estop_reason="asked for through the service estop"))
        return ActResult(success=True, message="stopped (let_go); estop_reset returns")

    def _estop_reset(self, act: Act, who: str) -> ActResult:
        self.state.observe_safety(SafetyView())
        return ActResult(success=True, message="reset")

    def _grasp(self, act: Act, who: str) -> ActResult:
        product = act.call.request["product"]
        if product == HOSTILE:
            return ActResult(success=False, message=f"product '{product}' is not in the mix")
        cell = self.state.cell
        self.state.observe_cell(replace(cell, mode="GRASPING", product=product))
        self.state.grasps.observe_result("GRIPPED", "both sides press", duration_s=1.2, latency_s=0.05, fingers=())
        self.state.observe_cell(
            replace(cell, mode="HOLDING", product=product, picks=cell.picks + 1, gripped=cell.gripped + 1)
        )
        return ActResult(success=True, message="GRIPPED: both sides press", answer=act)

    def _plan(self, act: Act, who: str) -> ActResult:
        asked = act.call.request
        steps = [
            SimpleNamespace(
                order=k, product=name, finger_set="power", swap_before=False, expected_success=0.9,
                predicted_time=4.0 * count, reason="",
            )
            for k, (name, count) in enumerate(zip(asked["products"], asked["quantities"], strict=True))
        ]  # fmt: skip
        if set(asked["products"]) - set(self.state.products):
            return ActResult(success=False, message="a product is not in the mix")
        answer = SimpleNamespace(
            steps=steps, swaps=0, predicted_time=sum(one.predicted_time for one in steps), expected_success=0.9,
            redundant_sets=["hook"],
        )  # fmt: skip
        return ActResult(success=True, message="planned", answer=answer)

    def _place_object(self, act: Act, who: str) -> ActResult:
        return ActResult(success=True, message="placed")

    def _swap(self, act: Act, who: str) -> ActResult:
        with self.state.locked() as state:
            state.swap.begin(act.call.request["finger_set"], who, time.time())
            state.swap.observe("open_palm", "Open the palm.", "t0ken", needs_confirmation=True)
            state.observe_cell(replace(state.cell, mode="SWAPPING"))
        return ActResult(success=True, message="begun")

    def _confirm_step(self, act: Act, who: str) -> ActResult:
        request, swap = act.call.request, self.state.swap
        if request["token"] != "t0ken" or request["step"] != swap.view.step:
            return ActResult(success=False, message="expected another step")
        step = STEPS[STEPS.index(swap.view.step) + 1]
        with self.state.locked() as state:
            if step == "unlock":
                mounted = tuple(
                    MountedView(name, serial, "pinch", "verified")
                    for name, serial in zip(SLOTS, self.serials, strict=True)
                )
                state.observe_cell(replace(state.cell, mode="IDLE", finger_set="pinch", mounted=mounted))
                swap.end(success=True, message="every finger is as its record says")
            else:
                if request["serials"]:
                    self.serials = request["serials"]
                swap.observe(step, f"Do {step}.", "t0ken", needs_confirmation=True)
        return ActResult(success=True, message="next")

    def _retire_finger(self, act: Act, who: str) -> ActResult:
        serial = act.call.request["serial"]
        if not act.call.request["reason"].strip():
            return ActResult(success=False, message="reason: expected some words")
        self.state.fingers = tuple(
            replace(one, state="retired", objection="retired") if one.serial == serial else one
            for one in self.state.fingers
        )
        return ActResult(success=True, message=f"finger {serial} is retired")

    def _release(self, act: Act, who: str) -> ActResult:
        self.state.observe_cell(replace(self.state.cell, mode="IDLE", product=""))
        return ActResult(success=True, message="released")


def feed(site: PanelSite, stop: threading.Event) -> None:
    """Play the streams: ten times a second."""
    state, number = site.desk.state, 0
    while not stop.wait(0.1):
        number += 1
        phase = 0.5 - 0.5 * math.cos(number / 15.0)
        state.observe_tensions(
            [TensionView(name, 0.016 * phase, 2.0 + 9.0 * phase + k, 1.5 + 7.0 * phase) for k, name in enumerate(SLOTS)]
        )
        state.observe_tendons([TendonView(name, "HOLDING", homed=True) for name in SLOTS])
        state.advance()
        image = np.full((480, 640, 3), 40, np.uint8)
        chain = [(120.0 + 90 * k, 200.0 + 60 * phase * k) for k in range(5)]
        cv2.polylines(image, [np.array(chain, np.int32)], isClosed=False, color=(180, 180, 180), thickness=22)
        jpeg = cv2.imencode(".jpg", image)[1].tobytes()
        site.picture = PanelPicture(
            number, jpeg, (640, 480), {"predicted": [(u, v + 6) for u, v in chain], "measured": chain}
        )
        state.grasps.observe_picture(jpeg)


def make_site(folder: Path, port: int) -> PanelSite:
    state = PanelState(time.time, time.monotonic)
    state.policy = StopPolicyView("let_go", 5.0)
    state.products = ("egg", "grape", "orange", HOSTILE)
    state.is_emulated = True
    state.observe_safety(SafetyView())
    state.owners = tuple(OwnerView(name, "") for name in SLOTS)
    mounted = tuple(MountedView(name, f"PW-{name[0].upper()}-01", "power", "verified") for name in SLOTS)
    state.observe_cell(CellView("IDLE", "power", mounted))
    state.fingers = tuple(
        FingerRecordView(
            f"PW-{name[0].upper()}-0{k}", "power", name, "2026-11-01", "TPU 85A", "PE braid",
            "mounted" if k == 1 else "store",
            1200 * k, 25_000, "2026-11-20", "", tuple((0.001 * j, 0.5 * j) for j in range(16)),
        )
        for name in SLOTS
        for k in (1, 2)
    )  # fmt: skip
    state.catalogue = tuple(
        ProductView(name, name, "power", 0.06, {"power": "success"}, {"power": 0.9}, {"power": 3})
        for name in state.products
    )
    (folder / "bags" / "softgrip_20261125").mkdir(parents=True, exist_ok=True)
    (folder / "bags" / "softgrip_20261125" / "part_0.mcap").write_bytes(b"MCAP" * 1000)
    accounts = Accounts(folder / "users.yaml" if (folder / "users.yaml").exists() else None)
    sessions = Sessions(time.monotonic, state.control.forget)
    desk = ActDesk(state, PretendedCell(state, folder / "calls"), ActRecord(folder / "acts.jsonl", time.time))
    worker, jobs = Worker(desk, WorkRun(time.monotonic)), BagJobs(BagFolder(folder / "bags"))
    return PanelSite(
        desk, worker, Texts(), accounts, sessions, LoginBrake(time.monotonic), OriginRule(port), jobs
    )  # fmt: skip


def main() -> None:
    folder = Path(sys.argv[1])
    bound = listen("127.0.0.1", 0 if len(sys.argv) < 3 else int(sys.argv[2]))
    port = bound.getsockname()[1]
    site = make_site(folder, port)
    server = WebServer(site.app(add_pages), bound)
    server.start()
    print(f"http://127.0.0.1:{port}/", flush=True)  # noqa: T201
    stop = threading.Event()
    threading.Thread(target=feed, args=(site, stop), daemon=True).start()
    sys.stdin.read()  # until the test is over
    stop.set()
    server.close()


if __name__ == "__main__":
    main()
