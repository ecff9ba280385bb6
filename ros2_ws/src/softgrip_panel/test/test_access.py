# SPDX-License-Identifier: Apache-2.0
"""Who may: accounts, sessions, the brake on guesses, origins, and the gate before everything."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from softgrip_panel.access import accounts as accounts_module
from softgrip_panel.access.accounts import Accounts, add_account, remove_account
from softgrip_panel.access.origin import OriginRule, is_loopback
from softgrip_panel.access.sessions import FREE_TRIES, IDLE_S, OLD_S, LoginBrake, Sessions
from softgrip_panel.commands import users
from softgrip_panel.errors import AccessError
from softgrip_panel.model.roles import Role
from softgrip_testing.manual_clock import ManualClock

pytest.importorskip("nicegui", reason="make panel-setup")
from softgrip_panel.web.gate import COOKIE, MAX_BODY, PERSON, Gate


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "users.yaml"
    add_account(path, "Ada", Role.OPERATE, "correct horse")
    return path


def test_only_the_right_password_opens(file: Path) -> None:
    accounts = Accounts(file)
    assert accounts.role_of("Ada", "correct horse") is Role.OPERATE
    for name, password in (("Ada", "correct hors"), ("Ada", ""), ("Bob", "correct horse"), ("", "")):
        assert accounts.role_of(name, password) is None


def test_the_file_holds_no_password_and_is_for_its_user_alone(file: Path) -> None:
    text = file.read_text()
    assert "correct" not in text
    assert file.stat().st_mode & 0o077 == 0
    add_account(file, "Bob", Role.LOOK, "correct horse")
    salts = [line for line in file.read_text().splitlines() if "salt" in line]
    assert len(set(salts)) == 2  # one password, two salts
    file.chmod(0o644)
    with pytest.raises(AccessError, match="mode 600"):
        Accounts(file)


def test_the_work_of_a_guess_is_one_that_owasp_names() -> None:
    # OWASP password storage cheat sheet, scrypt: equal settings of (N, r, p)
    named = {(2**17, 8, 1), (2**16, 8, 2), (2**15, 8, 3), (2**14, 8, 5)}
    assert (accounts_module.SCRYPT_N, accounts_module.SCRYPT_R, accounts_module.SCRYPT_P) in named


@pytest.mark.parametrize(
    "text", ["", "- a", "kind: other", "kind: softgrip_panel_users\nusers: {Ada: {role: king}}", "{"]
)
def test_a_strange_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "users.yaml"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(AccessError, match="users file"):
        Accounts(path)


def test_the_command_adds_lists_and_removes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import io  # noqa: PLC0415

    path = tmp_path / "users.yaml"
    monkeypatch.setattr("sys.stdin", io.StringIO("long enough\n"))
    assert users.main([str(path), "add", "Ida", "engineer"]) == 0
    assert Accounts(path).role_of("Ida", "long enough") is Role.ENGINEER
    monkeypatch.setattr("sys.stdin", io.StringIO("short\n"))
    assert users.main([str(path), "add", "Joe", "look"]) == 1
    assert users.main([str(path), "list"]) == 0
    assert capsys.readouterr().out == "Ida\n"
    remove_account(path, "Ida")
    assert Accounts(path).names == ()


def test_sessions_end_by_idleness_age_and_log_out() -> None:
    clock, ended = ManualClock(), []
    sessions = Sessions(clock, ended.append)
    token = sessions.open_session("Ada", Role.OPERATE)
    person = sessions.find(token)
    assert person is not None
    assert token not in repr(person)
    assert sessions.find("x" * len(token)) is None
    clock.s += IDLE_S - 1.0
    assert sessions.find(token) == person
    clock.s += IDLE_S + 1.0
    assert sessions.find(token) is None
    assert ended == [person.session]
    token = sessions.open_session("Ada", Role.OPERATE)
    for _ in range(int(OLD_S / IDLE_S) + 1):
        clock.s += IDLE_S
        sessions.find(token)
    assert sessions.find(token) is None


def test_guesses_have_to_wait_longer_and_longer() -> None:
    clock = ManualClock()
    brake = LoginBrake(clock)
    for _ in range(FREE_TRIES):
        brake.check("name Ada", "address a")
        brake.fail("name Ada", "address a")
    waits = []
    for _ in range(4):
        with pytest.raises(AccessError, match="wait"):
            brake.check("name Ada", "address other")  # another address does not help
        began_s = clock.s
        while True:
            clock.s += 0.5
            try:
                brake.check("name Ada", "address other")
            except AccessError:
                continue
            break
        waits.append(clock.s - began_s)
        brake.fail("name Ada", "address a")
    assert waits == [2.0, 4.0, 8.0, 16.0]
    brake.check("name Bob", "address b")
    brake.succeed("name Ada")
    brake.check("name Ada")


@pytest.mark.parametrize(
    ("host", "loopback"), [("127.0.0.1", True), ("::1", True), ("0.0.0.0", False), ("cell", False)]
)
def test_what_is_the_loopback(host: str, loopback: bool) -> None:
    assert is_loopback(host) is loopback


RULE = OriginRule(8480)


@pytest.mark.parametrize(
    ("host", "origin", "needs", "passes"),
    [
        ("127.0.0.1:8480", "http://127.0.0.1:8480", True, True),
        ("localhost:8480", "http://localhost:8480", True, True),
        ("[::1]:8480", "http://[::1]:8480", True, True),
        ("127.0.0.1:8480", None, False, True),
        ("127.0.0.1:8480", None, True, False),
        ("127.0.0.1:8480", "null", True, False),
        ("127.0.0.1:8480", "http://evil.example", True, False),
        ("127.0.0.1:8480", "http://127.0.0.1:8481", True, False),
        ("127.0.0.1:8480", "https://127.0.0.1:8480", True, False),
        ("127.0.0.1:8480", "http://127.0.0.1:8480.evil.example", True, False),
        ("evil.example:8480", "http://evil.example:8480", True, False),  # rebound to this machine
        ("evil.example", None, False, False),
        (None, None, False, False),
        ("127.0.0.1:x", None, False, False),
    ],
)
def test_only_the_panels_own_pages_may_ask(host: str | None, origin: str | None, needs: bool, passes: bool) -> None:
    if passes:
        RULE.check(host, origin, needs_origin=needs)
    else:
        with pytest.raises(AccessError):
            RULE.check(host, origin, needs_origin=needs)


# --- the gate


def ask(gate: Gate, **changes: Any) -> list[dict[str, Any]]:
    headers = {"host": "127.0.0.1:8480", **changes.pop("headers", {})}
    scope = {
        "type": "http",
        "method": "GET",
        "path": "/",
        "client": ("127.0.0.1", 1),
        "headers": [(key.encode(), value.encode()) for key, value in headers.items()],
        **changes,
    }
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request"}

    async def send(message: Any) -> None:
        sent.append(dict(message))

    asyncio.run(gate(scope, receive, send))
    return sent


@pytest.fixture
def gate() -> Any:
    passed: list[Any] = []
    refused: list[str] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        passed.append(scope)
        if scope["type"] == "http":
            await send({"type": "http.response.start", "status": 200, "headers": []})

    sessions = Sessions(ManualClock())
    made = Gate(app, RULE, sessions, lambda address, path, reason: refused.append(reason))
    made.passed, made.refused, made.token = passed, refused, sessions.open_session("Ada", Role.OPERATE)  # type: ignore[attr-defined]
    return made


def test_a_known_person_passes_with_name_and_gets_the_headers(gate: Any) -> None:
    (start,) = ask(gate, headers={"cookie": f"{COOKIE}={gate.token}"})
    assert gate.passed[0][PERSON].name == "Ada"
    headers = dict(start["headers"])
    assert b"connect-src 'self'" in headers[b"content-security-policy"]
    assert headers[b"x-frame-options"] == b"DENY"


def test_a_stranger_is_sent_to_the_log_in_and_gets_nothing_else(gate: Any) -> None:
    start = ask(gate, headers={"accept": "text/html"})[0]
    assert (start["status"], dict(start["headers"])[b"location"]) == (303, b"/login")
    for path in ("/live", "/_nicegui_ws/socket.io/", "/grasps.csv", "/assets/../login", "/assets/panel.js"):
        assert ask(gate, path=path)[0]["status"] == 401
    assert ask(gate, path="/login")[0]["status"] == 200


@pytest.mark.parametrize("cookie", [f"{COOKIE}=", f"{COOKIE}=forged", "=;=;", f'{COOKIE}="\\"', "a" * 5000])
def test_a_forged_session_is_none(gate: Any, cookie: str) -> None:
    assert ask(gate, headers={"cookie": cookie})[0]["status"] == 401


def test_a_websocket_of_another_origin_is_closed_and_written_down(gate: Any) -> None:
    cookie = {"cookie": f"{COOKIE}={gate.token}"}
    for origin in ({}, {"origin": "http://evil.example"}):
        (closed,) = ask(gate, type="websocket", path="/live", headers={**cookie, **origin})
        assert (closed["type"], closed["code"]) == ("websocket.close", 4403)
    assert len(gate.refused) == 2
    ask(gate, type="websocket", path="/live", headers={**cookie, "origin": "http://127.0.0.1:8480"})
    assert gate.passed[-1]["path"] == "/live"


def test_a_form_of_another_site_changes_nothing(gate: Any) -> None:
    cookie = {"cookie": f"{COOKIE}={gate.token}"}
    for origin in ({}, {"origin": "null"}, {"origin": "http://evil.example"}):
        start = ask(gate, method="POST", path="/act/estop", headers={**cookie, **origin})[0]
        assert start["status"] == 403
    assert gate.passed == []


@pytest.mark.parametrize("length", [str(MAX_BODY + 1), "-1", "x", "9" * 40])
def test_an_oversized_upload_is_refused_before_it_is_read(gate: Any, length: str) -> None:
    headers = {"cookie": f"{COOKIE}={gate.token}", "origin": "http://127.0.0.1:8480", "content-length": length}
    assert ask(gate, method="POST", path="/orders", headers=headers)[0]["status"] == 403


def test_a_header_that_stands_twice_counts_as_missing(gate: Any) -> None:
    scope = {
        "type": "http", "method": "GET", "path": "/", "client": None,
        "headers": [(b"host", b"127.0.0.1:8480"), (b"host", b"evil.example")],
    }  # fmt: skip
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(gate(scope, None, send))
    assert sent[0]["status"] == 403
