# SPDX-License-Identifier: Apache-2.0
"""What is installed is what was looked at: hashes, licences, the bill of materials, the image."""

from __future__ import annotations

import contextlib
import importlib.metadata
import re
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
DEPENDENCIES = (ROOT / "docs" / "dependencies.md").read_text()


def tool(name: str) -> ModuleType:
    return load_script(ROOT / "tools" / f"{name}.py")


sbom = tool("sbom")
audit = tool("audit")
PINS = [pin for lock in sbom.LOCKS for pin in sbom.pins(lock)]


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def words(table: str) -> set[str]:
    """Return every name in the first two columns of a table of docs/dependencies.md."""
    rows = [line.split("|") for line in table.splitlines() if line.startswith("|")]
    text = " ".join(" ".join(row[1:3]) for row in rows)
    return {normal(word) for word in re.findall(r"[A-Za-z0-9][A-Za-z0-9._-]*", text)}


def test_the_locks_hold_more_than_sixty_distributions() -> None:
    assert len(PINS) > 60  # else the locks are read wrongly


@pytest.mark.parametrize("pin", PINS, ids=lambda pin: pin.name)
def test_every_distribution_has_hashes_and_a_line_with_its_licence(pin: Any) -> None:
    assert pin.hashes
    assert normal(pin.name) in words(DEPENDENCIES.partition("## Libraries")[0])


def test_every_line_of_a_lock_is_a_pin_or_a_hash() -> None:
    for lock in sbom.LOCKS:
        for line in lock.read_text().splitlines():
            assert re.match(r"[a-z0-9-]+==\S+( ; .*)? \\$|    --hash=sha256:[0-9a-f]{64}( \\)?$", line), line


def test_setup_installs_by_hash_only_and_nothing_that_is_built() -> None:
    scripts = "".join((ROOT / name).read_text() for name in (".ci/setup.sh", ".ci/packages.sh", "Makefile"))
    installs = re.findall(r"^.*pip .*install .* -r .*$", scripts, re.MULTILINE)
    # what compiling takes, requirements.lock, what comes as sources, the capture lock, one rule for every other extra
    assert len(installs) == 5
    for line in installs:
        assert "--require-hashes" in line
        if "requirements-sources.lock" in line:  # what builds it has a hash, too: it stands in requirements.lock
            assert "--no-build-isolation" in line
            assert "--no-deps" in line
        else:
            assert "--only-binary :all:" in line


def test_the_oldest_versions_are_those_of_ubuntu_24_04_and_hashed_too() -> None:
    versions = dict(re.findall(r"^([A-Za-z-]+)==(\S+)", (ROOT / "requirements-oldest.in").read_text(), re.MULTILINE))
    pins = {pin.name: pin for pin in sbom.pins(ROOT / "requirements-oldest.lock")}
    assert {name: pins[normal(name)].version for name in versions} == versions
    assert all(pin.hashes for pin in pins.values())


def test_opencv_is_one_without_the_known_hole() -> None:
    (opencv,) = [pin for pin in PINS if pin.name == "opencv-python-headless"]
    assert tuple(map(int, opencv.version.split(".")[:2])) >= (4, 12)  # CVE-2025-53644 is closed in 4.12.0


@pytest.mark.parametrize("pin", [pin for pin in PINS if sbom.installed(pin)], ids=lambda pin: pin.name)
def test_the_libraries_inside_a_wheel_are_listed_with_it(pin: Any) -> None:
    table = DEPENDENCIES.partition("## Libraries")[2]
    lines = [
        line for line in table.splitlines() if normal(pin.name) in normal(line.split("|")[1] if "|" in line else "")
    ]
    for library in sbom.bundled_libraries(sbom.installed(pin)):
        stem = re.match(r"lib[A-Za-z0-9_]*?(?=64_|p-r0|-|$)", library)
        assert stem is not None
        assert any(stem[0] in line for line in lines), f"{library} of {pin.name} has no line in docs/dependencies.md"


def test_the_bill_of_materials_names_every_distribution_once() -> None:
    made = sbom.document()
    assert (made["bomFormat"], made["specVersion"]) == ("CycloneDX", "1.6")
    found = [(one["name"], one["version"], one["purl"]) for one in made["components"]]
    assert found == sorted({(pin.name, pin.version, pin.url) for pin in PINS}, key=lambda row: row[2])
    assert made["dependencies"][0]["dependsOn"] == [purl for _, _, purl in found]
    opencv = next(one for one in made["components"] if one["name"] == "opencv-python-headless")
    # where another version is installed (LOCK=oldest), nobody can look into the pinned one's wheel
    is_installed = importlib.metadata.version("opencv-python-headless") == opencv["version"]
    assert ("libavcodec" in {one["name"] for one in opencv.get("components", [])}) == is_installed


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ([{"name": "a", "version": "1", "vulns": []}], 0),
        ([{"name": "a", "version": "1", "vulns": [{"id": "CVE-1", "fix_versions": ["2"]}]}], 1),
        ([{"name": "a", "version": "1", "vulns": []}, {"name": "b", "skip_reason": "not found"}], 2),
        ([], 2),
    ],
)
def test_an_audit_that_could_not_ask_is_no_clean_one(found: list[dict[str, Any]], expected: int) -> None:
    assert audit.verdict("a.lock", found) == expected


def test_the_image_has_the_page_and_nothing_that_tests_alone_need() -> None:
    """As the Dockerfile's awk takes them from the locks."""
    dockerfile = (ROOT / "docker" / "Dockerfile").read_text()
    beside, left_out = (
        set(found.split("|")) for found in re.findall(r"wanted = !?/\^\(([a-z0-9|-]+)\)==/", dockerfile)[1:]
    )
    locked = {one.name: set(re.findall(r"^([a-z0-9-]+)==", one.read_text(), re.MULTILINE)) for one in sbom.LOCKS}
    assert beside <= locked["requirements.lock"]
    assert left_out <= locked["requirements-panel.lock"]
    tests = (ROOT / "requirements-panel.in").read_text().partition("# tests:")[2]
    assert left_out == set(re.findall(r"^([a-z0-9-]+)==", tests, re.MULTILINE))


def test_the_page_of_a_cell_without_a_network_is_reached_through_a_socket(tmp_path: Path) -> None:
    forward = str(ROOT / "docker" / "forward.py")
    with socket.create_server(("127.0.0.1", 0)) as page, socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        taken.close()
        here = f"tcp:127.0.0.1:{page.getsockname()[1]}"
        path = f"unix:{tmp_path}/page.sock"
        pairs = ((path, here), (f"tcp:127.0.0.1:{port}", path))
        running = [subprocess.Popen([sys.executable, forward, *pair]) for pair in pairs]
        try:
            client = _connected(port, deadline_s=time.monotonic() + 20.0)
            with client, page.accept()[0] as served:
                client.sendall(b"GET / HTTP/1.1")
                assert served.recv(100) == b"GET / HTTP/1.1"
                served.sendall(b"x" * 300_000)
                served.shutdown(socket.SHUT_WR)
                assert len(b"".join(iter(lambda: client.recv(65536), b""))) == 300_000
            assert (tmp_path / "page.sock").stat().st_mode & 0o077 == 0
        finally:
            for one in running:
                one.kill()
                one.wait()


def _connected(port: int, deadline_s: float) -> socket.socket:
    """Return a connection that gets through both halves; one that is closed at once met a half that was not up yet."""
    while time.monotonic() < deadline_s:
        with contextlib.suppress(OSError):
            found = socket.create_connection(("127.0.0.1", port), 5.0)
            found.settimeout(0.3)
            try:
                found.recv(1)
            except TimeoutError:
                found.settimeout(10.0)
                return found
            found.close()
        time.sleep(0.02)
    raise AssertionError("expected both halves to be up")


def test_the_image_runs_without_rights_and_without_a_network() -> None:
    dockerfile = (ROOT / "docker" / "Dockerfile").read_text()
    (image,) = re.findall(r"^ARG BASE=(\S+)$", dockerfile, re.MULTILINE)
    assert re.fullmatch(r"ros:jazzy-ros-base@sha256:[0-9a-f]{64}", image)
    assert f"container: {image}\n" in (ROOT / ".github" / "workflows" / "test.yml").read_text()
    assert re.search(r"^USER (?!root)\w+", dockerfile, re.MULTILINE)
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST" in dockerfile
    assert "RMW_IMPLEMENTATION=" in dockerfile
    assert dockerfile.index("USER softgrip") < dockerfile.index("ENTRYPOINT")
    services = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())["services"]
    page = services["page"]
    assert page["ports"] == ["127.0.0.1:8480:8480"]  # of this machine alone
    assert page["entrypoint"][:2] == ["python3", "/forward.py"]  # and nothing else is run where there is a network
    for name, service in services.items():
        assert name == "page" or service["network_mode"] == "none"
        assert service["read_only"] is True
        assert service["cap_drop"] == ["ALL"]
        assert not service["user"].startswith("0")
