# SPDX-License-Identifier: Apache-2.0
"""A busy cell for the page model, in simulated time: what a page left open for hours gets to see."""

from __future__ import annotations

import time
from dataclasses import replace

import cv2
import numpy as np
from panel_site import SLOTS, driver_health

from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.facts import TendonView, TensionView
from softgrip_panel.model.frames import PanelPicture
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.web.site import PanelSite

TICK_S = 0.1
GRASP_TICKS, GRASPING_TICKS, ALARM_TICKS = 200, 50, 600
PERSON = Person("bench", "Ada", Role.ENGINEER)


class SimulatedTime:
    """A clock that ticks."""

    def __init__(self) -> None:
        self.s = time.time()

    def __call__(self) -> float:
        """Return the time [s]."""
        return self.s


def pictures() -> list[bytes]:
    """Return camera frames of noise, which compress badly."""
    random = np.random.default_rng(29)
    frames = (random.integers(0, 255, (480, 640, 3), dtype=np.uint8) // 8 * 8 for _ in range(20))
    return [cv2.imencode(".jpg", cv2.GaussianBlur(one, (9, 9), 0))[1].tobytes() for one in frames]


class BusyCell:
    """Plays a busy cell to the page model, tick by tick.

    Args:
        desk: with the state.
        clock: of the state.
        grasp_ticks: from grasp to grasp.
        site: shows the pictures, None = nobody looks.
    """

    def __init__(
        self, desk: ActDesk, clock: SimulatedTime, grasp_ticks: int = GRASP_TICKS, site: PanelSite | None = None
    ) -> None:
        self.desk, self.clock, self.state, self.site = desk, clock, desk.state, site
        self.frames = pictures()
        self.grasp_ticks, self.grasps = grasp_ticks, 0

    def tick(self, number: int) -> None:
        """Let a tenth of a second pass."""
        self.clock.s += TICK_S
        state, phase = self.state, number % self.grasp_ticks
        has_fault = number % ALARM_TICKS < 30
        tension_n = 2.0 + 0.1 * phase
        state.observe_tendons(
            [TendonView(name, "HOLDING", homed=True, fault="tendon_broken" if has_fault else "") for name in SLOTS]
        )
        state.observe_tensions([TensionView(name, 0.01, tension_n, 1.5) for name in SLOTS])
        frame = self.frames[number % len(self.frames)]
        state.grasps.observe_picture(frame)
        if self.site is not None:
            self.site.picture = PanelPicture(number, frame, (640, 480), {"measured": [(1.0, 2.0)] * 5})
        if number % 10 == 0:
            state.observe_health(driver_health(0.0))
        if number % ALARM_TICKS == 40:
            for alarm in state.alarms.active:
                self.desk.acknowledge(PERSON, alarm.key)
        self._grasp(phase)
        state.advance()

    def _grasp(self, phase: int) -> None:
        cell = self.state.cell
        assert cell is not None
        if phase == 0:
            self.grasps += 1
            self.state.observe_cell(replace(cell, mode="GRASPING", product=f"product_{self.grasps}"))
        elif phase == GRASPING_TICKS:
            self.state.grasps.observe_result("GRIPPED", "both sides press", duration_s=5.0, latency_s=0.05, fingers=())
            self.state.observe_cell(replace(cell, mode="HOLDING", picks=cell.picks + 1, gripped=cell.gripped + 1))
