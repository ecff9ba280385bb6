# SPDX-License-Identifier: Apache-2.0
"""Page Set-up, camera: views of the board, the lens found from them and given to the camera; the plane's commands."""

from __future__ import annotations

import asyncio

from nicegui import background_tasks, ui

from softgrip_panel.errors import PanelError
from softgrip_panel.model import acts
from softgrip_panel.model.lens import COLUMNS, ROWS, SQUARE_MM
from softgrip_panel.model.roles import Role
from softgrip_panel.web.parts import card, command
from softgrip_panel.web.shell import Page, element, text_element


def camera_card(page: Page) -> None:
    """Make the card."""
    shown, lens = page.shown, page.site.lens
    with card(page, "setup.camera", "camera-card"):
        text_element("p", page.t("setup.camera_how"))
        element("canvas", id="camera", width="640", height="480", role="img", aria_label=page.t("setup.camera_aria"))
        text_element("p", page.t("cell.no_picture"), id="no-picture")
        shown.text(text_element("p", "", "instruction", id="views", role="status"), lambda: _views_text(page))
        _coverage(page)
        if page.person.role >= Role.ENGINEER:
            _acts(page)
        text_element("h3", page.t("setup.plane"))
        text_element("p", page.t("setup.plane_how"), "note")
        holder = element("div")

        def write(_: object) -> None:
            for line in lens.commands(page.site.calibration_file, page.site.watched_finger):
                command(page, line)

        shown.parts(holder, lambda: lens.board, write)


def _views_text(page: Page) -> str:
    lens = page.site.lens
    if lens.fit is not None:
        focal = lens.fit.lens.matrix[0, 0], lens.fit.lens.matrix[1, 1]
        return page.t("setup.lens_found", rms=lens.fit.rms_px, fx=focal[0], fy=focal[1], views=len(lens.views))
    return lens.problem or page.t("setup.views", views=len(lens.views))


def _coverage(page: Page) -> None:
    """Draw which parts of the picture have shown the board."""
    holder = element("div", classes="coverage", role="img", aria_label=page.t("setup.coverage"))

    def write(_: object) -> None:
        for row in page.site.lens.covered():
            for is_covered in row:
                element("span", data_state="covered" if is_covered else "")

    page.shown.parts(holder, lambda: len(page.site.lens.views), write)


def _acts(page: Page) -> None:
    lens = page.site.lens
    problem = text_element("p", "", "problem", role="alert", id="view-problem")
    with element("div", classes="row"):
        columns = ui.number(page.t("setup.columns"), value=COLUMNS, min=3, max=40, step=1)
        rows = ui.number(page.t("setup.rows"), value=ROWS, min=3, max=40, step=1)
        square = ui.number(page.t("setup.square"), value=SQUARE_MM, min=1, max=500, step=0.1)
        for field in (columns, rows, square):
            field.props("outlined dense").classes("grow")

    async def work(what: str) -> None:
        problem.set_text("")
        try:
            if what == "start":
                lens.start(int(columns.value or 0), int(rows.value or 0), float(square.value or 0.0))
            elif what == "find":
                await asyncio.to_thread(lens.find_lens)
            else:
                picture = page.site.picture
                await asyncio.to_thread(lens.add_view, picture.jpeg if picture else b"")
        except (PanelError, ValueError) as error:
            problem.set_text(str(error))

    def use() -> None:
        found = lens.fit.lens if lens.fit else None
        if found is not None:
            page.begin_act(
                acts.set_camera_info(
                    found.width,
                    found.height,
                    found.matrix.ravel().tolist(),
                    found.distortion.tolist(),
                    found.distortion_model,
                )
            )

    def begin(what: str) -> None:
        background_tasks.create(work(what))

    with element("div", classes="row"):
        page.button("setup.take_view", lambda: begin("take"), "big", name="take-view")
        page.button("setup.find_lens", lambda: begin("find"), "big", name="find-lens")
        page.button("setup.start_views", lambda: begin("start"), name="start-views")
        set_lens = page.button("setup.use_lens", use, "big", name="use-lens")
        page.shown.enabled(set_lens, lambda: page.may_act and lens.fit is not None)
