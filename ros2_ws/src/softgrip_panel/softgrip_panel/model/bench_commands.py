# SPDX-License-Identifier: Apache-2.0
"""The bench's commands that a page runs itself: the same as at a terminal, one at a time, with what they say.

None of them moves anything: they list servos, measure the bus, or write one servo's ID. They need the bus for
themselves, so the driver has to be off it.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from softgrip_panel.errors import ActRefusedError
from softgrip_panel.model.acts import ActResult
from softgrip_panel.model.bench import BenchView, TerminalStep
from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.texts import say

#: A command takes no longer [s]; a scan of every baud rate takes half a minute.
LIMIT_S: Final = 300.0
#: It has so long to end when it is asked to, and is killed then [s].
END_S: Final = 3.0
#: So many lines of what it says are kept, each so long.
MAX_LINES: Final = 200
MAX_CHARS: Final = 400


@dataclass(frozen=True)
class BenchOutput:
    """What the last command said.

    Attributes:
        key: of the step; "" = none yet.
        command: as typed at a terminal.
        lines: of what it said, errors among it.
        is_running: whether it goes on.
        code: with which it ended; None = it goes on, or could not be started.
    """

    key: str = ""
    command: str = ""
    lines: tuple[str, ...] = ()
    is_running: bool = False
    code: int | None = None


class BenchCommands:
    """Runs one command at a time.

    Args:
        desk: checks and records.
        bench: what the driver says of itself.
    """

    def __init__(self, desk: ActDesk, bench: Callable[[], BenchView]) -> None:
        self._desk = desk
        self._bench = bench
        self._lines: deque[str] = deque(maxlen=MAX_LINES)
        self._output = BenchOutput()
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None
        self._asked_to_end = asyncio.Event()

    @property
    def output(self) -> BenchOutput:
        """What the last command has said so far."""
        one = self._output
        return BenchOutput(one.key, one.command, tuple(self._lines), one.is_running, one.code)

    def begin_step(self, person: Person, step: TerminalStep) -> ActResult:
        """Start a command; it goes on when the page is left, and every page shows what it says."""

        def start() -> str:
            if not step.is_run_here:
                raise ActRefusedError(say("error.terminal_only", command=step.command))
            if self._output.is_running:
                raise ActRefusedError(say("error.bench_busy", command=self._output.command))
            if self._bench().has_bus:
                raise ActRefusedError(say("setup.bus_busy"))
            self._lines.clear()
            self._asked_to_end = asyncio.Event()
            self._output = BenchOutput(step.key, step.command, is_running=True)
            self._task = asyncio.get_running_loop().create_task(self._run(person, step))
            return say("done.begun")

        return self._desk.carry_out(person, "bench", step.command, start, needs_control=True, role=Role.ENGINEER)

    def stop(self, person: Person) -> ActResult:
        """Ask the command to end; one that does not within END_S is killed."""

        def end() -> str:
            if not self._output.is_running:
                raise ActRefusedError(say("error.bench_idle"))
            self._asked_to_end.set()
            return say("done.asked_to_end")

        return self._desk.carry_out(person, "bench_end", self._output.command, end, needs_control=False)

    async def _run(self, person: Person, step: TerminalStep) -> None:
        code: int | None = None
        try:
            self._process = await asyncio.create_subprocess_exec(
                *step.words,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
                start_new_session=True,
            )
            code = await self._followed(self._process)
        except OSError as error:
            self._lines.append(str(error))
        finally:
            self._process = None
            self._output = BenchOutput(step.key, step.command, code=code)
        self._desk.record_event(person.name, "bench", step.command, success=code == 0, message=f"exit code {code}")

    async def _followed(self, process: asyncio.subprocess.Process) -> int:
        """Keep what a process says, and return its code; one that takes too long, or is asked to, is ended."""
        reading = asyncio.ensure_future(self._read(process))
        asked = asyncio.ensure_future(self._asked_to_end.wait())
        done, _ = await asyncio.wait({reading, asked}, timeout=LIMIT_S, return_when=asyncio.FIRST_COMPLETED)
        asked.cancel()
        if reading not in done:
            if not done:
                self._lines.append(say("error.job_late"))
            self._signal(signal.SIGINT)
            done, _ = await asyncio.wait({reading}, timeout=END_S)
            if not done:
                self._signal(signal.SIGKILL)
                await reading
        return await process.wait()

    async def _read(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        rest = b""
        while data := await process.stdout.read(4096):
            *lines, rest = (rest + data).split(b"\n")
            self._lines.extend(line.decode("utf-8", "replace")[:MAX_CHARS] for line in lines)
            rest = rest[-MAX_CHARS:]
        if rest:
            self._lines.append(rest.decode("utf-8", "replace"))

    def _signal(self, number: signal.Signals) -> None:
        """Signal the process and all that it started."""
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
