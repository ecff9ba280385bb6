# SPDX-License-Identifier: Apache-2.0
"""What a hostile browser, page or program sends to a running site: refused, and written down."""

from __future__ import annotations

import http.client
from typing import Any
from urllib.parse import urlencode, urlsplit

import pytest

from softgrip_panel.access.sessions import FREE_TRIES

pytest.importorskip("nicegui", reason="make panel-setup")
pytest.importorskip("websockets", reason="make panel-setup")
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.protocol import State
from websockets.sync.client import connect

from softgrip_panel.web.gate import COOKIE

#: conftest's
RunningSite = Any
Answer = tuple[int, dict[str, str], str]


def ask(site: RunningSite, method: str, path: str, body: str = "", cookie: str = "", **headers: str) -> Answer:
    place = urlsplit(site.address)
    connection = http.client.HTTPConnection(place.hostname or "", place.port, timeout=10.0)
    given = {"Origin": site.address, "Content-Type": "application/x-www-form-urlencoded", **headers}
    if cookie:
        given["Cookie"] = f"{COOKIE}={cookie}"
    connection.request(method, path, body or None, {key: value for key, value in given.items() if value})
    answer = connection.getresponse()
    found = (
        answer.status,
        {key.lower(): value for key, value in answer.getheaders()},
        answer.read().decode("utf-8", "replace"),
    )
    connection.close()
    return found


def log_in(site: RunningSite, name: str, password: str) -> Answer:
    return ask(site, "POST", "/login", urlencode({"name": name, "password": password}))


def token_of(site: RunningSite, name: str) -> str:
    status, headers, _ = log_in(site, name, f"{name} has one")
    assert status == 303
    cookie = headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    return cookie.partition("=")[2].partition(";")[0]


def test_wrong_log_ins_are_refused_slowed_down_and_recorded(guessed_site: RunningSite) -> None:
    for _ in range(FREE_TRIES):
        status, headers, text = log_in(guessed_site, "Ida", "guess")
        assert (status, "set-cookie" in headers) == (403, False)
        assert "wrong" in text
    status, _, text = log_in(guessed_site, "Ida", "Ida has one")  # even the right one has to wait now
    assert status == 403
    assert "too many wrong log-ins" in text
    refused = [one for one in guessed_site.recorded() if one["act"] == "login" and not one["success"]]
    assert len(refused) == FREE_TRIES + 1
    assert "guess" not in (guessed_site.folder / "acts.jsonl").read_text()


def test_a_name_with_markup_comes_back_as_text(site: RunningSite) -> None:
    status, _, text = log_in(site, "<script>alert(1)</script>" * 3, "")
    assert status == 403
    assert "<script>" not in text


def test_without_a_session_there_is_nothing(site: RunningSite) -> None:
    for path in (
        "/",
        "/work",
        "/grasps.csv",
        "/label/PW-I-01",
        "/grasps/1/at.jpg",
        "/assets/panel.js",
        "/_nicegui_ws/socket.io/",
    ):
        status, _, text = ask(site, "GET", path, Accept="*/*")
        assert status == 401, path
        assert "PW-I-01" not in text
    assert ask(site, "POST", "/act/estop")[0] == 401
    assert not [one for one in site.calls() if one["act"] == "estop"]


@pytest.mark.parametrize(
    "path",
    [
        "/assets/../panel.css",
        "/assets/..%2f..%2fsite.py",
        "/assets/%2e%2e/%2e%2e/site.py",
        "/assets//etc/passwd",
        "/label/..%2f..%2fusers.yaml",
        "/bags/..%2f..%2fusers.yaml",
        "/bags/%2fetc%2fpasswd",
        "/bags/softgrip_20261125/files/..%2f..%2f..%2facts.jsonl",
        "/bags/softgrip_20261125/files/%2fetc%2fpasswd",
        "/bags/..%2fbags%2fsoftgrip_20261125/files/part_0.mcap",
        "/bags/../../acts.jsonl/report",
        "/grasps/1/..%2fat.jpg",
    ],
)
def test_no_path_leads_out(site: RunningSite, path: str) -> None:
    token = token_of_open(site)
    status, _, text = ask(site, "GET", path, cookie=token)
    assert status == 404
    assert "class PanelSite" not in text
    assert "root:x" not in text
    assert any(one["act"] == "request" and not one["success"] for one in site.recorded())


def token_of_open(site: RunningSite) -> str:
    return log_in(site, "Ada", "")[1]["set-cookie"].partition("=")[2].partition(";")[0]


def test_who_only_looks_may_stop_and_nothing_else(guarded_site: RunningSite) -> None:
    token = token_of(guarded_site, "Eve")
    status, _, text = ask(guarded_site, "POST", "/act/estop", cookie=token)
    assert status == 200
    assert '"success":true' in text
    assert [one["who"] for one in guarded_site.calls()] == ["Eve"]


def test_a_form_of_another_site_is_refused_and_recorded(site: RunningSite) -> None:
    token = token_of_open(site)
    for origin in ("http://evil.example", "null", ""):
        assert ask(site, "POST", "/act/estop", cookie=token, Origin=origin)[0] == 403
    assert ask(site, "GET", "/", cookie=token, Host="evil.example")[0] == 403
    assert sum(one["act"] == "request" for one in site.recorded()) >= 4
    assert site.calls() == []


@pytest.mark.parametrize("path", ["/live", "/shapes", "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"])
def test_a_websocket_of_another_origin_or_without_a_session_is_closed(site: RunningSite, path: str) -> None:
    token = token_of_open(site)
    url = site.address.replace("http", "ws") + path
    for origin, cookie in ((None, token), ("http://evil.example", token), (site.address, "forged")):
        with pytest.raises(InvalidStatus) as refused:
            connect(url, origin=origin, additional_headers={"Cookie": f"{COOKIE}={cookie}"}, open_timeout=10.0)  # type: ignore[arg-type]
        assert refused.value.response.status_code == 403
    with connect(url, origin=site.address, additional_headers={"Cookie": f"{COOKIE}={token}"}) as socket:  # type: ignore[arg-type]
        # a shape comes when there is one; until then the socket stays open
        assert socket.state is State.OPEN if path == "/shapes" else socket.recv(timeout=10.0)


def test_a_forged_session_is_written_down_once_and_without_its_token(site: RunningSite) -> None:
    for _ in range(3):
        assert ask(site, "GET", "/grasps.csv", cookie="f0rged-token")[0] == 401
    found = [one for one in site.recorded() if "forged" in str(one["message"]) and one["subject"] == "/grasps.csv"]
    assert len(found) == 1
    assert "f0rged-token" not in (site.folder / "acts.jsonl").read_text()


def test_a_message_that_is_too_large_ends_its_websocket(site: RunningSite) -> None:
    token = token_of_open(site)
    url = site.address.replace("http", "ws") + "/live"
    with connect(url, origin=site.address, additional_headers={"Cookie": f"{COOKIE}={token}"}) as socket:  # type: ignore[arg-type]
        socket.send(b"x" * 300_000)
        with pytest.raises(ConnectionClosed) as ended:
            receive_to_the_end(socket)
        assert ended.value.rcvd is not None
        assert ended.value.rcvd.code == 1009  # too big, RFC 6455


def receive_to_the_end(socket: Any) -> None:
    while True:
        socket.recv(timeout=10.0)


def test_a_session_ends_with_its_log_out(site: RunningSite) -> None:
    token = token_of_open(site)
    assert ask(site, "GET", "/grasps.csv", cookie=token)[0] == 200
    assert ask(site, "POST", "/logout", cookie=token)[0] == 303
    assert ask(site, "GET", "/grasps.csv", cookie=token)[0] == 401


def test_an_oversized_upload_is_refused(site: RunningSite) -> None:
    token = token_of_open(site)
    assert ask(site, "POST", "/login", "x" * 300_000, cookie=token)[0] == 403
