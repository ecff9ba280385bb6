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

from softgrip_model.finger import Finger
from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, mesh_finger
from softgrip_model.profile import load
from softgrip_panel.access.accounts import Accounts
from softgrip_panel.access.origin import OriginRule
from softgrip_panel.access.record import ActRecord
from softgrip_panel.access.sessions import LoginBrake, Sessions
from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.bags import BagFolder, BagJobs
from softgrip_panel.model.bench import BenchView
from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.facts import (
    CellView,
    ComponentHealth,
    CountedView,
    FingerDecision,
    FingerRecordView,
    FingerView,
    MountedView,
    OwnerView,
    ProductView,
    ResidualView,
    SafetyView,
    StopPolicyView,
    TendonView,
    TensionView,
)
from softgrip_panel.model.frames import PanelPicture
from softgrip_panel.model.friction import FrictionModelView, RigPoint, RigProgress
from softgrip_panel.model.parameters import ParameterKind, ParameterView
from softgrip_panel.model.residuals import WatchLimits
from softgrip_panel.model.shapes import FaceOwners, PanelShape
from softgrip_panel.model.state import PanelState
from softgrip_panel.model.swap import CONFIRMED, STEPS, SwapPhase, SwapView
from softgrip_panel.model.work import Worker, WorkRun
from softgrip_panel.texts import Texts
from softgrip_panel.web.pages.every import add_pages
from softgrip_panel.web.server import WebServer, listen
from softgrip_panel.web.site import PanelSite

SLOTS = ("index", "middle", "thumb")
#: Of every product, by finger set; the last set is a user's own (docs/how-to/own-finger.md).
MARKS = {"power": "success", "pinch": "", "hook": "failure", "my_pinch": "success"}
#: A name that an attacker would give a product.
HOSTILE = "<img src=x onerror=window.hacked=1>"


#: As long as a real one.
REASON = (
    "both sides press: contact tension [N] index -3.6 (contact from 1.4), middle -3.3 (contact from 1.5), thumb +3.3"
)
#: What the verdict of every grasp knows.
JUDGED = (FingerDecision("index", "BLOCKED", 3.1, 0.9), FingerDecision("thumb", "FREE", 0.1, 0.9))


class PretendedCell:
    """Answers acts at once; keeps what was asked for."""

    def __init__(self, state: PanelState, file: Path) -> None:
        self.state = state
        self._file, self.folder = file, file.parent
        self.serials: list[str] = []
        self.homings = 0
        self.parameters = (
            ParameterView("jpeg_quality", ParameterKind.INTEGER, 90, "of frames [%]", 50.0, 100.0, "", True),
            ParameterView("source", ParameterKind.STRING, HOSTILE, "device or stream"),
        )

    async def call(self, act: Act, who: str) -> ActResult:
        with self._file.open("a") as out:
            out.write(json.dumps({"act": act.name, "who": who, "request": dict(act.call.request)}) + "\n")
        await asyncio.sleep(0.01)
        answer = getattr(self, f"_{act.name}", None)
        return answer(act, who) if answer else ActResult(success=True, message="done")

    def cancel(self, act_name: str) -> None:
        with self._file.open("a") as out:
            out.write(json.dumps({"act": f"cancel {act_name}"}) + "\n")
        if act_name == "swap":
            with self.state.locked() as state:
                state.swap.end(success=False, message="CANCELLED: ended at the page")
                state.observe_cell(replace(state.cell, mode="IDLE"))

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
        if product == "orange":
            return ActResult(success=False, message="TENDON_FAULT: index: no reply", answer=act)
        cell = self.state.cell
        self.state.observe_cell(replace(cell, mode="GRASPING", product=product))
        self.state.grasps.observe_result(
            "GRIPPED", REASON, duration_s=1.2, latency_s=0.05, fingers=JUDGED, decided_stamp_s=time.time()
        )
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
            state.swap.begin_swap(act.call.request["finger_set"], who, time.time())
            state.swap.observe("open_palm", "Open the palm.", "t0ken", needs_confirmation=True)
            state.observe_cell(replace(state.cell, mode="SWAPPING"))
        return ActResult(success=True, message="begun")

    def _confirm_step(self, act: Act, who: str) -> ActResult:
        request, swap = act.call.request, self.state.swap
        if request["token"] != "t0ken" or act.subject.split()[0] != swap.view.step:
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

    def _calibrate(self, act: Act, who: str) -> ActResult:
        self.state.rig = RigProgress(
            is_running=True, needs_confirmation=True, index=0, total=2, angle_rad=1.5708, load_kg=0.5,
            instruction="Set 90 deg and hang 0.50 kg.",
        )  # fmt: skip
        return ActResult(success=True, message="begun")

    def _confirm_rig(self, act: Act, who: str) -> ActResult:
        rig = self.state.rig
        point = RigPoint(rig.index, rig.angle_rad, rig.load_kg, 9.81 * rig.load_kg, 12.2 * rig.load_kg, 0.04,
                         "ACCEPTED", "")  # fmt: skip
        rig = replace(rig, points=(*rig.points, point))
        if rig.index:
            fitted = replace(self.state.friction_models[0], id="braid-new", is_active=False)
            self.state.friction_models = (fitted, *self.state.friction_models)
            rig = RigProgress(points=rig.points, message="SUCCEEDED: usable", fitted="braid-new")
        else:
            rig = replace(rig, index=1, load_kg=1.0, instruction="Set 90 deg and hang 1.00 kg.")
        self.state.rig = rig
        return ActResult(success=True, message="measured")

    def _activate_friction(self, act: Act, who: str) -> ActResult:
        self.state.friction_active = act.call.request["id"]
        return ActResult(success=True, message="active")

    def _retire_finger(self, act: Act, who: str) -> ActResult:
        serial = act.call.request["serial"]
        if not act.call.request["reason"].strip():
            return ActResult(success=False, message="reason: expected some words")
        self.state.fingers = tuple(
            replace(one, state="retired", objection="retired") if one.serial == serial else one
            for one in self.state.fingers
        )
        return ActResult(success=True, message=f"finger {serial} is retired")

    def _set_driver(self, act: Act, who: str) -> ActResult:
        phases = {"deactivate": "inactive", "cleanup": "unconfigured", "configure": "inactive", "activate": "active"}
        phase = phases[act.call.request["transition"]["label"]]
        with self.state.locked() as state:
            state.bench = replace(state.bench, phase=phase)
        return ActResult(success=True, message="")

    def _home(self, act: Act, who: str) -> ActResult:
        self.homings += 1  # the second leaves the zero elsewhere: knots bed in
        return ActResult(success=True, message="homed")

    def _set_parameter(self, act: Act, who: str) -> ActResult:
        (setting,) = act.call.request["parameters"]
        self.parameters = tuple(
            replace(one, value=setting["value"][one.kind.field]) if one.name == setting["name"] else one
            for one in self.parameters
        )
        return ActResult(success=True, message="")

    def nodes(self) -> tuple[str, ...]:
        return ("camera", "tendon_driver")

    async def read(self, node: str) -> tuple[ParameterView, ...]:
        return self.parameters

    def _release(self, act: Act, who: str) -> ActResult:
        self.state.observe_cell(replace(self.state.cell, mode="IDLE", product=""))
        return ActResult(success=True, message="released")


PROFILES = Path(__file__).resolve().parents[2] / "softgrip_bringup" / "profiles"


def rest_shape() -> PanelShape:
    """The power hand's index finger at rest, with a strain that rises from base to tip."""
    loaded = load(PROFILES / "power.yaml")
    finger = Finger.from_profile(loaded, "index")
    mesh = mesh_finger(finger, RESOLUTIONS["coarse"], 1e3 * loaded.finger("index").body_height_m).mesh
    strain = np.linspace(0.0, 0.2, len(mesh.hexes)).astype("<f4")
    vertices = (1e-3 * mesh.nodes).astype("<f4")
    return PanelShape(
        0, "index", mesh.digest, vertices.tobytes(), mesh.surface().ravel().astype(np.uint32), strain.tobytes(),
        converged=True, pulled_length_m=0.0, rate_hz=10.0, reason="",
    )  # fmt: skip


def driver_health(zero_mm: float) -> list[ComponentHealth]:
    """What the driver says of its bus and its servos."""
    bus = {"rate [Hz]": "100.0", "jitter p99 [ms]": "0.21", "missed cycles": "0", "lost replies": "3"}
    servo = {"zero [mm]": f"{zero_mm:.3f}", "current [A]": "0.120", "temperature [degC]": "31", "voltage [V]": "5.0"}
    return [
        ComponentHealth("tendon_driver: bus", 0, "running", bus),
        *(ComponentHealth(f"tendon_driver: {name}", 0, "holding", servo) for name in SLOTS),
    ]


def bedded_zero_mm(homings: int) -> float:
    """Zeros that move by 0.5, 0.05 and no more millimetres from homing to homing."""
    return {0: 0.0, 1: 1.0, 2: 1.5}.get(homings, 1.55)


def foreign_swap(words: str) -> SwapView:
    """What cell/swap_progress says of another client's swap: a step, "hands_out" or "done"."""
    goal = {"finger_set": "hook", "goal_id": "0f" * 16, "started_s": time.time() - 61.0}
    if words == "hands_out":
        return SwapView(SwapPhase.HANDS_INSIDE, needs_confirmation=True, message="cancelled", **goal)
    if words == "done":
        return SwapView(SwapPhase.ENDED, success=True, message="every finger is as its record says", **goal)
    return SwapView(
        SwapPhase.RUNNING, step=words, instruction=f"Others do {words}.", needs_confirmation=words in CONFIRMED, **goal
    )


def feed(site: PanelSite, stop: threading.Event) -> None:
    """Play the streams: ten times a second."""
    state, number, shape = site.desk.state, 0, rest_shape()
    site.owners, site.shape_profile = FaceOwners(PROFILES), "power"
    while not stop.wait(0.1):
        number += 1
        phase = 0.5 - 0.5 * math.cos(number / 15.0)
        pulled_n = 2.0 + 9.0 * phase + 0.6 * (-1) ** number  # nothing that hangs on it is ever at rest
        state.observe_tensions(
            [TensionView(name, 0.016 * phase, pulled_n + k, 1.5 + 7.0 * phase) for k, name in enumerate(SLOTS)],
            time.time(),
        )
        state.observe_tendons([TendonView(name, "HOLDING", homed=True) for name in SLOTS])
        state.observe_health(driver_health(bedded_zero_mm(site.cell.homings)))  # type: ignore[attr-defined]
        state.advance()
        image = np.full((480, 640, 3), 40, np.uint8)
        chain = [(120.0 + 90 * k, 200.0 + 60 * phase * k) for k in range(5)]
        cv2.polylines(image, [np.array(chain, np.int32)], isClosed=False, color=(180, 180, 180), thickness=22)
        jpeg = cv2.imencode(".jpg", image)[1].tobytes()
        foreign = site.cell.folder / "foreign_swap"  # type: ignore[attr-defined]
        if foreign.exists():
            with state.locked():
                state.swap.observe_progress(foreign_swap(foreign.read_text()))
            foreign.unlink()
        shown = site.cell.folder / "shown.jpg"  # type: ignore[attr-defined]
        if shown.exists():
            jpeg = shown.read_bytes()
        site.picture = PanelPicture(
            number, jpeg, (640, 480), {"predicted": [(u, v + 6) for u, v in chain], "measured": chain}
        )
        state.grasps.observe_picture(jpeg)
        site.shape = replace(shape, number=number)
        angles = tuple(phase * k for k in (0.3, 0.5, 0.7))
        state.predicted = tuple(FingerView(name, angles) for name in SLOTS)
        state.measured = (FingerView("index", angles),)
        state.observe_residual(
            ResidualView("index", 0.0012, 1.1, 0.4 + number // 40, 0.2, "OK", "learning the baseline: closing 1 of 5")
        )


def is_secure(folder: Path) -> bool:
    return (folder / "panel.pem").exists()


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
    state.fingers += (replace(state.fingers[0], serial=HOSTILE, profile=HOSTILE, state="store", objection=HOSTILE),)
    state.catalogue = tuple(
        ProductView(name, name, "power", 0.06, MARKS, {"power": 0.9}, {"power": 3}) for name in state.products
    )
    (folder / "bags" / "softgrip_20261125").mkdir(parents=True, exist_ok=True)
    (folder / "bags" / HOSTILE).mkdir(exist_ok=True)
    (folder / "bags" / HOSTILE / f"{HOSTILE}.mcap").write_bytes(b"MCAP")
    (folder / "bags" / "softgrip_20261125" / "part_0.mcap").write_bytes(b"MCAP" * 1000)
    state.observe_counted(
        [
            CountedView(
                1.7e9,
                "grape",
                "pinch",
                "EMPTY",
                "nothing between the fingers",
                2.0,
                ("PI-I-07", "PI-M-07", "PI-T-07"),
                1.7e9 - 0.8,
                JUDGED,
            ),
        ]
    )
    state.friction_models = (
        FrictionModelView(
            "pe-braid-0.25-mm-tpu-printed-along-the-layers-matte-20261126T035452Z", "matte",
            (("alpha", 0.21, 0.02), ("n", 0.9, 0.01), ("epsilon", 0.096, 0.048), ("lambda", 0.017, 0.026)),
            0.02, 0.05, 9, 90_000.0, "USABLE", "average error 1.0%, 95 % interval within 4.5%", is_active=True,
            law_found=FrictionLaw(Law.MATTE, (0.21, 0.9, 0.096, 0.017), 3.125, angle_range=(0.5, 6.2832),
                                  tension_range=(1.0, 20.0)),
            covariance=tuple(np.diag([1e-4, 2.5e-5, 6e-4, 1.7e-4]).ravel()), degrees_of_freedom=5,
        ),
    )  # fmt: skip
    state.friction_active = state.friction_models[0].id
    state.watch_limits = WatchLimits.of("shifts", 6.0, 15.0, 5.0)
    accounts = Accounts(folder / "users.yaml" if (folder / "users.yaml").exists() else None)
    sessions = Sessions(time.monotonic, state.control.forget)
    cell = PretendedCell(state, folder / "calls")
    state.bench = BenchView("active", "/dev/servos", 1_000_000, SLOTS, (1, 2, 3), ("XL330-M288",))
    state.nodes = cell.nodes()
    desk = ActDesk(state, cell, ActRecord(folder / "acts.jsonl", time.time))
    worker, jobs = Worker(desk, WorkRun(time.monotonic)), BagJobs(BagFolder(folder / "bags"))
    site = PanelSite(
        desk, worker, Texts(), accounts, sessions, LoginBrake(time.monotonic), OriginRule(port, is_secure(folder)), jobs
    )  # fmt: skip
    site.parameters, site.lens.folder = cell, folder / "views"
    site.cell = cell  # type: ignore[attr-defined]
    return site


def main() -> None:
    folder = Path(sys.argv[1])
    bound = listen("127.0.0.1", 0 if len(sys.argv) < 3 else int(sys.argv[2]))
    port = bound.getsockname()[1]
    site = make_site(folder, port)
    tls = (folder / "panel.pem", folder / "panel.key") if is_secure(folder) else None
    server = WebServer(site.app(add_pages), bound, tls)
    server.start()
    print(f"{'https' if tls else 'http'}://127.0.0.1:{port}/", flush=True)  # noqa: T201
    stop = threading.Event()
    threading.Thread(target=feed, args=(site, stop), daemon=True).start()
    sys.stdin.read()  # until the test is over
    stop.set()
    server.close()


if __name__ == "__main__":
    main()
