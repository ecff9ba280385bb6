# SPDX-License-Identifier: Apache-2.0
"""Runs the processes of a launch: starts, prefixes their output, and ends them all without leaving one."""

from __future__ import annotations

import contextlib
import itertools
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from embedded_ros.child import PARENT_VARIABLE

if TYPE_CHECKING:
    from pathlib import Path

    from embedded_ros.launch_description import Process

#: [B] of a log file, and how many older ones are kept.
_LOG_BYTES, _LOG_FILES = 20 << 20, 3
#: What a node that refuses to start ends with (softgrip's convention); its keeper then interrupts the launch.
_CANNOT_START = 2
_STEPS = ((signal.SIGINT, 5.0), (signal.SIGTERM, 5.0), (getattr(signal, "SIGKILL", signal.SIGTERM), 5.0))


class _Event(NamedTuple):
    kind: str
    running: _Running | None = None
    detail: Any = None


class _Running:
    """A process that was started."""

    def __init__(self, process: Process, popen: subprocess.Popen[bytes]) -> None:
        self.process = process
        self.popen = popen
        self.ended = False
        self.readers: list[threading.Thread] = []


class RotatingLog:
    """A text file that is put aside when it has grown long; the oldest of those is dropped.

    Args:
        path: of the file; older ones are ``path.1``, ``path.2``, ...
        max_bytes: [B] of one file.
        kept: older files that are kept.
    """

    def __init__(self, path: Path, max_bytes: int = _LOG_BYTES, kept: int = _LOG_FILES) -> None:
        self._path = path
        self._max_bytes = max_bytes
        self._kept = kept
        self._file = path.open("a", encoding="utf-8")

    def write_line(self, text: str) -> None:
        """Append a line."""
        if self._file.tell() > self._max_bytes:
            self._rotate()
        self._file.write(text + "\n")
        self._file.flush()

    def _rotate(self) -> None:
        self._file.close()
        names = [self._path, *(self._path.with_name(f"{self._path.name}.{n}") for n in range(1, self._kept + 1))]
        for newer, older in reversed(list(itertools.pairwise(names))):
            if newer.exists():
                newer.replace(older)
        self._file = self._path.open("a", encoding="utf-8")

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class LaunchRunner:
    """Runs until all processes have ended, one with on_exit=shutdown ends, or a signal comes."""

    def __init__(self, processes: list[Process], log_folder: Path) -> None:
        self._events: queue.SimpleQueue[_Event] = queue.SimpleQueue()
        self._processes = processes
        self._running: list[_Running] = []
        self._stopping = False
        self._step = 0
        self._step_at = 0.0
        self._failed = False
        log_folder.mkdir(parents=True, exist_ok=True)
        self._log = RotatingLog(log_folder / "launch.log")

    def run(self) -> int:
        """Run; return 0, or 1 when a process failed to start or ended everything by failing."""
        previous = {number: signal.signal(number, self._on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            for process in self._processes:
                if not self._stopping:
                    self._start(process)
            while self._running:
                self._handle_one()
        finally:
            self._kill_all()
            for number, handler in previous.items():
                signal.signal(number, handler)
            self._log.close()
        return 1 if self._failed else 0

    def _on_signal(self, number: int, _frame: object) -> None:
        self._events.put(_Event("signal", None, number))

    # -- starting ---------------------------------------------------------------------------------------------

    def _start(self, process: Process) -> None:
        environment = {**process.environment, PARENT_VARIABLE: str(os.getpid())}
        try:
            popen = subprocess.Popen(
                process.command,
                cwd=process.cwd,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=False,
                # Their own group: Ctrl-C in a terminal reaches them only through us, once, and helpers of theirs too.
                process_group=0 if os.name == "posix" else None,
            )
        except OSError as error:
            self._say("ERROR", process.label, f"cannot be started: {error.strerror}: {process.command[0]}")
            self._failed = True
            self._stop("a process could not be started")
            return
        running = _Running(process, popen)
        self._running.append(running)
        self._say("INFO", process.label, f"process started with pid [{popen.pid}]")
        for stream, to_screen in (
            (popen.stdout, process.output in {"screen", "both", "full"}),
            (popen.stderr, process.output != "own_log"),
        ):
            reader = threading.Thread(target=self._read, args=(running, stream, to_screen), daemon=True)
            reader.start()
            running.readers.append(reader)
        threading.Thread(target=self._wait, args=(running,), daemon=True).start()

    def _read(self, running: _Running, stream: IO[bytes], to_screen: bool) -> None:
        with stream:
            for line in stream:
                self._events.put(_Event("line", running, (line.decode(errors="replace").rstrip("\n"), to_screen)))

    def _wait(self, running: _Running) -> None:
        code = running.popen.wait()
        for reader in running.readers:
            reader.join(timeout=1.0)
        self._events.put(_Event("exit", running, code))

    # -- events -----------------------------------------------------------------------------------------------

    def _handle_one(self) -> None:
        timeout_s = max(0.0, self._step_at - time.monotonic()) if self._stopping else 3600.0
        try:
            event = self._events.get(timeout=timeout_s)
        except queue.Empty:
            event = None
        if event is not None:
            self._handle(event)
        if self._stopping and time.monotonic() >= self._step_at:
            self._escalate()

    def _handle(self, event: _Event) -> None:
        if event.kind == "signal":
            if not self._stopping:
                self._say("WARNING" if event.detail == signal.SIGINT else "INFO", "launch",
                          f"user interrupted with {signal.Signals(event.detail).name}")  # fmt: skip
                self._stop("")
            return
        running = event.running
        if running is None:
            return
        if event.kind == "line":
            text, to_screen = event.detail
            self._write(f"[{running.process.label}] {text}", to_screen=to_screen)
        else:
            self._on_exit(running, event.detail)

    def _on_exit(self, running: _Running, code: int) -> None:
        running.ended = True
        self._running.remove(running)
        process = running.process
        _signal_group(running.popen.pid, getattr(signal, "SIGKILL", signal.SIGTERM))
        if code == 0:
            self._say("INFO", process.label, f"process has finished cleanly [pid {running.popen.pid}]")
        elif not self._stopping or code not in {-signal.SIGINT, -signal.SIGTERM, 130, 143}:
            command = " ".join(process.command)
            self._say(
                "ERROR",
                process.label,
                f"process has died [pid {running.popen.pid}, exit code {code}, cmd '{command}'].",
            )
        if self._stopping:
            self._failed = self._failed or code == _CANNOT_START
            return
        if process.on_exit_shutdown:
            self._failed = self._failed or code != 0
            self._stop(f"{process.label} ended and its on_exit is shutdown")

    # -- stopping ---------------------------------------------------------------------------------------------

    def _stop(self, reason: str) -> None:
        if self._stopping:
            return
        if reason:
            self._say("INFO", "launch", f"process[es] will be shut down: {reason}")
        self._stopping = True
        self._step = 0
        self._escalate()

    def _escalate(self) -> None:
        number, signal_timeout_s = _STEPS[min(self._step, len(_STEPS) - 1)]
        for running in self._running:
            self._say("INFO", running.process.label, f"sending signal '{signal.Signals(number).name}' to process")
            _signal_group(running.popen.pid, number)
        self._step += 1
        self._step_at = time.monotonic() + signal_timeout_s

    def _kill_all(self) -> None:
        for running in self._running:
            _signal_group(running.popen.pid, getattr(signal, "SIGKILL", signal.SIGTERM))

    # -- output -----------------------------------------------------------------------------------------------

    def _say(self, level: str, who: str, text: str) -> None:
        self._write(f"[{level}] [{who}]: {text}", to_screen=True)

    def _write(self, text: str, *, to_screen: bool) -> None:
        self._log.write_line(text)
        if to_screen:
            with contextlib.suppress(BrokenPipeError):
                sys.stdout.write(text + "\n")
                sys.stdout.flush()


def _signal_group(pid: int, number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if os.name == "posix":
            os.killpg(pid, number)
        else:
            os.kill(pid, signal.SIGTERM)
