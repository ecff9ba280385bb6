# SPDX-License-Identifier: Apache-2.0
"""How the panel starts: on the loopback only, elsewhere with log-in and TLS, and without NiceGUI with a plain word."""

from __future__ import annotations

import os
import ssl
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from softgrip_nodekit import StartupError
from softgrip_panel.errors import PanelError
from softgrip_panel.nodes.panel import PARAMETERS, _check_access

pytest.importorskip("nicegui", reason="make panel-setup")
from softgrip_panel.web.server import FIRST_PORT, listen

DEFAULTS = {row.name: row.default for row in PARAMETERS.rows}


def check(**changes: str) -> None:
    _check_access(DEFAULTS | changes)


def test_as_shipped_it_listens_on_the_loopback() -> None:
    check()
    assert DEFAULTS["host"] == "127.0.0.1"


@pytest.mark.parametrize(
    ("changes", "missing"),
    [
        ({}, "users_file and tls_certificate"),
        ({"users_file": "u"}, "tls_certificate"),
        ({"tls_certificate": "c", "tls_key": "k"}, "users_file"),
    ],
)
def test_elsewhere_only_with_log_in_and_tls(changes: dict[str, str], missing: str) -> None:
    with pytest.raises(StartupError, match=f"expected {missing}, found none"):
        check(host="0.0.0.0", **changes)
    check(host="0.0.0.0", users_file="u", tls_certificate="c", tls_key="k")


def test_a_certificate_without_its_key_is_refused() -> None:
    with pytest.raises(StartupError, match="both or none"):
        check(tls_certificate="c")


def test_a_taken_port_is_named_and_without_one_the_next_is_taken() -> None:
    first = listen("127.0.0.1", 0)
    port = first.getsockname()[1]
    assert port >= FIRST_PORT
    with pytest.raises(PanelError, match=f"port {port}"):
        listen("127.0.0.1", port)
    second = listen("127.0.0.1", 0)
    assert second.getsockname()[1] > port
    first.close()
    second.close()


@pytest.mark.ros
def test_without_nicegui_it_says_how_to_get_it_and_ends_alone() -> None:
    code = "import sys; sys.modules['nicegui'] = None; from softgrip_panel.nodes.panel import main; sys.exit(main([]))"
    environment = os.environ | {"ROS_DOMAIN_ID": "97"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0, check=False, env=environment
    )
    assert done.returncode == 2
    assert "make panel-setup" in done.stderr
    assert "panel:=false" in done.stderr
    assert "Traceback" not in done.stderr


def test_with_a_certificate_it_speaks_tls_only_and_its_cookie_too(tmp_path: Path, start_site: Any) -> None:
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
         "-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(tmp_path / "panel.key"),
         "-out", str(tmp_path / "panel.pem")],
        check=True, capture_output=True,
    )  # fmt: skip
    site = start_site(tmp_path)
    assert site.address.startswith("https://")
    context = ssl.create_default_context(cafile=str(tmp_path / "panel.pem"))
    request = urllib.request.Request(f"{site.address}/login", b"name=Ada", {"Origin": site.address})

    class Stay(urllib.request.HTTPRedirectHandler):
        def redirect_request(self, *_: Any) -> None:
            return None

    opener = urllib.request.build_opener(urllib.request.HTTPSHandler(context=context), Stay())
    with pytest.raises(urllib.error.HTTPError) as answer:
        opener.open(request, timeout=10.0)
    assert answer.value.code == 303
    assert "Secure" in answer.value.headers["set-cookie"]
    with pytest.raises((urllib.error.URLError, ConnectionError)):
        urllib.request.urlopen(site.address.replace("https", "http") + "/login", timeout=10.0)
