# SPDX-License-Identifier: Apache-2.0
"""Run the shipped launch files as a user does: as processes, in a domain of their own."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy

from softgrip_testing.free_domains import FreeDomains
from softgrip_testing.process_table import node_processes, session_processes
from softgrip_testing.waiting import wait_until

_DOMAINS = FreeDomains(start=os.getpid())


def environment_of(domain: int, folder: Path) -> dict[str, str]:
    """Return the environment of a process in a domain, with its logs below a folder."""
    return os.environ | {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_HOME": str(folder / "ros_home"),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }


class Launched:
    """A `ros2 launch` with all of its processes, its output, and its end."""

    def __init__(self, arguments: list[str], domain: int, log: Path) -> None:
        self.domain = domain
        self.environment = environment_of(domain, log.parent)
        self.started = time.monotonic()
        self.process = subprocess.Popen(
            arguments,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=self.environment,
            start_new_session=True,
        )
        self._lines: list[str] = []
        self._log = log
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def output(self) -> str:
        return "".join(self._lines)

    def wait_for(self, text: str, timeout: float) -> None:
        """Wait until the output contains a text."""
        deadline = time.monotonic() + timeout
        while text not in self.output:
            assert time.monotonic() < deadline, f"expected {text!r} within {timeout} s, found:\n{self.output[-4000:]}"
            assert self.process.poll() is None or text in self.output, f"ended before {text!r}:\n{self.output[-4000:]}"
            self._reader.join(0.05)

    def wait_for_end(self, timeout: float) -> int:
        """Wait until the launch has ended; returns its exit code."""
        try:
            code = self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            pytest.fail(f"expected the launch to end within {timeout} s, found:\n{self.output[-8000:]}")
        self._reader.join(5.0)
        return code

    def interrupt(self) -> None:
        """Ctrl-C."""
        os.killpg(self.process.pid, signal.SIGINT)

    def survivors(self, timeout: float = 30.0) -> list[str]:
        """Return the command lines of processes of this launch that outlive ``timeout`` [s].

        Launch kills a keeper after ten seconds, not its node: a recorder may still be writing to a slow disk then.
        """
        deadline = time.monotonic() + timeout
        while (left := self._alive()) and time.monotonic() < deadline:
            self._reader.join(0.05)
        return left

    def ask(self, *arguments: str) -> str:
        """Return what a `ros2` command in the same domain prints."""
        answer = subprocess.run(
            ["ros2", *arguments], capture_output=True, text=True, env=self.environment, timeout=20, check=False
        )
        return answer.stdout

    def ask_until(self, ask: tuple[str, ...], text: str, timeout_s: float = 150.0) -> None:
        """Ask until an answer holds a text; on a busy machine the one who asks may give up before it comes."""
        deadline_s, answer = time.monotonic() + timeout_s, ""
        while text not in answer:
            assert time.monotonic() < deadline_s, f"expected {text!r}, found {answer!r}:\n{self.output[-4000:]}"
            with contextlib.suppress(subprocess.TimeoutExpired):
                answer = self.ask(*ask)

    def node_process(self, name: str) -> int | None:
        """Return the process id of a node of the launch; None while it is not running."""
        return node_processes(self.process.pid).get(name)

    def close(self) -> None:
        for process in session_processes(self.process.pid):
            with contextlib.suppress(ProcessLookupError):  # the end of one is the end of others
                os.kill(process, signal.SIGKILL)
        self.process.wait(30.0)
        self._reader.join(30.0)

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self._log.open("w") as log, self.process.stdout as output:
            for line in output:
                self._lines.append(line)
                log.write(line)
                log.flush()

    def _alive(self) -> list[str]:
        return [command.replace("\0", " ") for command in session_processes(self.process.pid).values()]


def _launches(tmp_path: Path) -> Iterator[Callable[..., Launched]]:
    launched: list[Launched] = []
    taken: list[int] = []

    def start(*arguments: str, domain: int | None = None) -> Launched:
        if domain is None:
            domain = _DOMAINS.take_domain()
            taken.append(domain)
        has_place = any(argument.startswith("wire_dir:=") for argument in arguments)
        place = [f"wire_dir:={tmp_path}/wires-{domain}"] if "launch" in arguments and not has_place else []
        if "launch" in arguments and not any(argument.startswith("panel:=") for argument in arguments):
            place.append("panel:=false")  # a test of the page asks for it
        log = tmp_path / f"log-{domain}-{len(launched)}.txt"
        launched.append(Launched([*arguments, *place], domain, log))
        return launched[-1]

    yield start
    for one in launched:
        one.close()
    for domain in taken:
        _DOMAINS.release(domain)


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Callable[..., Launched]]:
    """Start a command in a domain of its own; everything is killed at the end of the test."""
    yield from _launches(tmp_path)


@pytest.fixture
def secure_router(tmp_path: Path) -> Iterator[Callable[[Path], None]]:
    """Start the router of a keystore where the middleware wants one: rmw_zenoh_cpp does, embedded/ has its own."""
    routers: list[subprocess.Popen[bytes]] = []

    def start(keys: Path) -> None:
        if rclpy.get_rmw_implementation_identifier() != "rmw_zenoh_cpp" or importlib.util.find_spec("embedded_ros"):
            return
        environment = os.environ | {"ZENOH_ROUTER_CONFIG_URI": str(keys / "zenoh" / "router.json5")}
        command = ["ros2", "run", "rmw_zenoh_cpp", "rmw_zenohd"]
        with (tmp_path / "router.txt").open("wb") as log:
            routers.append(subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True))
        wait_until(lambda: "Started Zenoh router" in (tmp_path / "router.txt").read_text(), "the router")

    yield start
    for router in routers:
        os.killpg(router.pid, signal.SIGKILL)
        router.wait()


@pytest.fixture
def two_environments(tmp_path: Path) -> Iterator[tuple[dict[str, str], dict[str, str]]]:
    """Return the environments of two domains that nobody else is in."""
    domains = (_DOMAINS.take_domain(), _DOMAINS.take_domain())
    yield environment_of(domains[0], tmp_path), environment_of(domains[1], tmp_path)
    for domain in domains:
        _DOMAINS.release(domain)


@pytest.fixture(scope="module")
def launch_module(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Launched]]:
    """As `launch`, for all tests of a module."""
    yield from _launches(tmp_path_factory.mktemp("launch"))
