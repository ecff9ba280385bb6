# SPDX-License-Identifier: Apache-2.0
"""The web site: log-in, stop, live data, files, and the pages, behind the gate."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Final
from urllib.parse import parse_qs

from fastapi import FastAPI
from nicegui import ui
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.websockets import WebSocket, WebSocketDisconnect

from softgrip_panel.access.accounts import Accounts, check_name
from softgrip_panel.access.origin import OriginRule
from softgrip_panel.access.sessions import LoginBrake, Sessions
from softgrip_panel.errors import AccessError, PanelError
from softgrip_panel.model import acts
from softgrip_panel.model.bags import BagJobs
from softgrip_panel.model.bench_commands import BenchCommands
from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.facts import FingerRecordView
from softgrip_panel.model.frames import PanelPicture, pack_picture, pack_tensions
from softgrip_panel.model.lens import LensViews
from softgrip_panel.model.parameters import ParameterReader
from softgrip_panel.model.records import GraspFilter, export_csv, grasp_rows
from softgrip_panel.model.roles import Role
from softgrip_panel.model.shapes import FaceOwners, PanelShape, pack_faces, pack_shape
from softgrip_panel.model.tensioning import Tensioning
from softgrip_panel.model.work import Worker
from softgrip_panel.texts import Texts
from softgrip_panel.web.gate import COOKIE, TOKEN, App, Gate, person_of

STATIC: Final = Path(__file__).parent / "static"
#: Nothing is sent to a page more often [s].
PERIOD_S: Final = 0.1
_ASSETS: Final = {"panel.css": "text/css", "panel.js": "text/javascript", "shape.js": "text/javascript"}


@dataclass
class PanelSite:
    """What the pages are made of.

    Attributes:
        desk: does acts and knows the state.
        worker: runs order lists.
        texts: all words.
        accounts: who may log in.
        sessions: who is logged in.
        brake: on wrong log-ins.
        rule: host and origin.
        jobs: bags with their reports and replays.
        namespace: of the cell, for the commands that pages show.
        picture: newest camera frame, None before the first.
        shape: newest deformed finger, None before the first; `shape_profile` is what it was printed from.
        owners: which hexahedron a face belongs to.
        viewers: pages that show live data now.
        parameters: reads those of the cell's nodes, None = nobody can be asked.
        lens: views of the board.
        calibration_file, watched_finger: the camera's, for the commands of Set-up.
        tensioning: rounds of it; `bench_commands`: what needs the bus for itself.
        log: says what was refused.
        label: makes the label of a finger.
    """

    desk: ActDesk
    worker: Worker
    texts: Texts
    accounts: Accounts
    sessions: Sessions
    brake: LoginBrake
    rule: OriginRule
    jobs: BagJobs
    namespace: str = "/"
    picture: PanelPicture | None = None
    viewers: int = 0
    shape: PanelShape | None = None
    shape_profile: str = ""
    owners: FaceOwners = field(default_factory=lambda: FaceOwners(None))
    parameters: ParameterReader | None = None
    lens: LensViews = field(default_factory=lambda: LensViews(None))
    calibration_file: str = ""
    watched_finger: str = "index"
    log: Callable[[str], object] = print
    label: Callable[[FingerRecordView, Texts], str] | None = None

    def __post_init__(self) -> None:
        state = self.desk.state
        self.tensioning = Tensioning(self.desk, lambda: state.bench)
        self.bench_commands = BenchCommands(self.desk, lambda: state.bench)

    def app(self, pages: Callable[[PanelSite], None]) -> App:
        """Return the whole site as ASGI.

        Args:
            pages: adds the pages to NiceGUI.
        """
        app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        app.add_api_route("/login", self._login_page, methods=["GET"], include_in_schema=False)
        app.add_api_route("/login", self._login, methods=["POST"], include_in_schema=False)
        app.add_api_route("/logout", self._logout, methods=["POST"], include_in_schema=False)
        app.add_api_route("/act/estop", self._estop, methods=["POST"], include_in_schema=False)
        app.add_api_route("/assets/{name}", _asset, methods=["GET"], include_in_schema=False)
        app.add_api_route("/grasps.csv", self._grasps_csv, methods=["GET"], include_in_schema=False)
        app.add_api_route(
            "/grasps/{number}/{moment}.jpg", self._grasp_picture, methods=["GET"], include_in_schema=False
        )
        app.add_api_route("/bags/{bag}/files/{name}", self._bag_file, methods=["GET"], include_in_schema=False)
        app.add_api_route("/bags/{bag}/report", self._bag_report, methods=["GET"], include_in_schema=False)
        app.add_api_route("/label/{serial}", self._label, methods=["GET"], include_in_schema=False)
        app.add_api_websocket_route("/live", self._live)
        app.add_api_websocket_route("/shapes", self._shape_socket)
        pages(self)
        ui.run_with(
            app,
            title=self.texts("title"),
            favicon="🖐",
            dark=None,
            language="en-US",
            binding_refresh_interval=None,
            tailwind=False,
            show_welcome_message=False,
            reconnect_timeout=5.0,
            message_history_length=200,
        )
        return Gate(app, self.rule, self.sessions, self._on_refusal)

    def _on_refusal(self, address: str, path: str, reason: str) -> None:
        self.log(f"refused a request from {address} for {path[:80]!r}: {reason}")
        self.desk.record_event(address, "request", path[:80], success=False, message=reason)

    async def _login_page(self) -> Response:
        return HTMLResponse(self._login_html(""))

    async def _login(self, request: Request) -> Response:
        address = request.client.host if request.client else "?"
        fields = parse_qs((await request.body()).decode("utf-8", "replace"), max_num_fields=10)
        given = (fields.get("name") or [""])[0]
        password = (fields.get("password") or [""])[0]
        try:
            name = check_name(given)
            self.brake.check(f"name {name}", f"address {address}")
            role = await self._role_of(name, password)
            if role is None:
                self.brake.fail(f"name {name}", f"address {address}")
                raise AccessError(self.texts("login.wrong"))
        except AccessError as error:
            self.desk.record_event(given[:40], "login", address, success=False, message=str(error))
            return HTMLResponse(self._login_html(str(error)), status_code=403)
        self.brake.succeed(f"name {name}")
        token = self.sessions.open_session(name, role)
        self.desk.record_event(name, "login", address, success=True, message=role.word)
        response = RedirectResponse("/", status_code=303)
        response.set_cookie(COOKIE, token, httponly=True, samesite="strict", secure=self.rule.is_secure, path="/")
        return response

    async def _role_of(self, name: str, password: str) -> Role | None:
        if not self.accounts.need_password:
            return Role.ENGINEER
        # a tenth of a second of one processor, beside the pages
        return await asyncio.to_thread(self.accounts.role_of, name, password)

    async def _logout(self, request: Request) -> Response:
        person = person_of(request.scope)
        self.sessions.end(request.scope[TOKEN])
        self.desk.record_event(person.name, "logout", "", success=True, message="")
        response = RedirectResponse("/login", status_code=303)
        response.delete_cookie(COOKIE, path="/")
        return response

    async def _estop(self, request: Request) -> Response:
        """Stop; a request of its own, which no page and no websocket can hold up."""
        result = await self.desk.perform(person_of(request.scope), acts.estop())
        key = "estop.done" if result.success else "estop.failed"
        return JSONResponse({"success": result.success, "text": self.texts(key, message=result.message)})

    async def _grasps_csv(self, product: str = "", serial: str = "", outcome: str = "") -> Response:
        chosen = GraspFilter(product, serial, outcome)
        with self.desk.state.locked() as state:
            rows = grasp_rows(state.grasps.records, state.counted)
        text = export_csv(row for row in rows if chosen.admits(row))
        return Response(text, media_type="text/csv", headers={"content-disposition": "attachment; filename=grasps.csv"})

    async def _grasp_picture(self, number: int, moment: str) -> Response:
        record = self.desk.state.grasps.find(number)
        jpeg = record.pictures.get(moment) if record else None
        return Response(jpeg, media_type="image/jpeg") if jpeg else Response("no such picture\n", status_code=404)

    async def _bag_file(self, bag: str, name: str) -> Response:
        try:
            file = self.jobs.folder.file(bag, name)
        except PanelError as error:
            return Response(f"{error}\n", status_code=404)
        return FileResponse(file, filename=name, media_type="application/octet-stream")

    async def _bag_report(self, bag: str) -> Response:
        try:
            file = self.jobs.folder.report(bag)
        except PanelError as error:
            return Response(f"{error}\n", status_code=404)
        if not file.is_file():
            return Response("no report yet\n", status_code=404)
        # what a bag holds may come from anywhere: its report runs without this site's session
        headers = {"content-security-policy": "sandbox allow-scripts"}
        return FileResponse(file, media_type="text/html", headers=headers)

    async def _label(self, serial: str) -> Response:
        record = next((one for one in self.desk.state.fingers if one.serial == serial), None)
        if record is None or self.label is None:
            return Response("no such finger\n", status_code=404)
        return HTMLResponse(self.label(record, self.texts))

    async def _live(self, socket: WebSocket) -> None:
        """Send pictures and tensions to one page, each when it has changed and at most ten times a second."""
        person = person_of(socket.scope)
        await socket.accept()
        self.viewers += 1
        leaving = asyncio.ensure_future(socket.receive())
        try:
            await self._send_changes(socket, person.session, leaving)
        except (WebSocketDisconnect, RuntimeError):
            return
        finally:
            self.viewers -= 1
            leaving.cancel()

    async def _send_changes(self, socket: WebSocket, session: str, leaving: asyncio.Future[object]) -> None:
        sent_number, sent_tensions = -1, b""
        state = self.desk.state
        while not leaving.done() and self.sessions.find(socket.scope[TOKEN]) is not None:
            state.control.observe_page(session)
            tensions = pack_tensions(state.tensions, state.is_stale)
            if tensions != sent_tensions:
                sent_tensions = tensions
                await socket.send_bytes(tensions)
            picture = self.picture
            if picture is not None and picture.number != sent_number:
                sent_number = picture.number
                await socket.send_bytes(pack_picture(picture))
            await asyncio.wait({leaving}, timeout=PERIOD_S)

    async def _shape_socket(self, socket: WebSocket) -> None:
        """Send a page the newest shape whenever there is another one; faces once for each mesh."""
        person_of(socket.scope)
        await socket.accept()
        leaving = asyncio.ensure_future(socket.receive())
        sent_mesh, sent_number = "", -1
        try:
            while not leaving.done() and self.sessions.find(socket.scope[TOKEN]) is not None:
                shape = self.shape
                if shape is not None and shape.number != sent_number:
                    if shape.mesh != sent_mesh:
                        owners = await asyncio.to_thread(self.owners.find, shape, self.shape_profile)
                        await socket.send_bytes(pack_faces(shape, owners))
                    sent_mesh, sent_number = shape.mesh, shape.number
                    await socket.send_bytes(pack_shape(shape))
                await asyncio.wait({leaving}, timeout=PERIOD_S)
        except (WebSocketDisconnect, RuntimeError):
            return
        finally:
            leaving.cancel()

    def _login_html(self, problem: str) -> str:
        t = self.texts
        password = (
            f'<label for="password">{escape(t("login.password"))}</label>'
            '<input id="password" name="password" type="password" autocomplete="current-password" required>'
            if self.accounts.need_password
            else f'<p class="note">{escape(t("login.open"))}</p>'
        )
        alert = f'<p class="problem" role="alert">{escape(problem)}</p>' if problem else ""
        return (
            f'<!doctype html><html lang="{escape(t.language)}"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{escape(t('login.title'))} - {escape(t('title'))}</title>"
            '<link rel="icon" href="data:,"><link rel="stylesheet" href="/assets/panel.css"></head>'
            '<body class="login"><main>'
            f'<h1>{escape(t("title"))}</h1>{alert}<form method="post" action="/login">'
            f'<label for="name">{escape(t("login.name"))}</label>'
            '<input id="name" name="name" autocomplete="username" maxlength="40" required autofocus>'
            f'{password}<button type="submit">{escape(t("login.submit"))}</button></form>'
            f'<p class="note">{escape(t("no_safety_device"))}</p></main></body></html>'
        )


async def _asset(name: str) -> Response:
    kind = _ASSETS.get(name)
    if kind is None:
        return Response("no such file\n", status_code=404)
    return FileResponse(STATIC / name, media_type=kind, headers={"cache-control": "no-cache"})
