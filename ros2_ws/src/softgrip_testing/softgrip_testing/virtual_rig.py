# SPDX-License-Identifier: Apache-2.0
"""The driver's rig code on the emulated rig in virtual time: the same bytes, no pseudo-terminals, no waiting.

Fifty calibrations take seconds, and never depend on the machine.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from softgrip_driver.errors import PortLostError
from softgrip_driver.rig import mark10
from softgrip_driver.rig.devices import Gauge, Stage
from softgrip_driver.rig.grbl import GrblStage
from softgrip_driver.rig.line_port import LinePort
from softgrip_driver.rig.mark10_gauge import Mark10Gauge
from softgrip_driver.rig.mark10_stand import Mark10Stand
from softgrip_driver.rig.procedure import JudgedPoint, Procedure, ProcedureStep, RigSettings
from softgrip_driver.rig.pull import RigSample
from softgrip_driver.rig.slide import PointVerdict
from softgrip_emulator.rig import EmulatedRig
from softgrip_emulator.rig.truth import RigTruth
from softgrip_emulator.wire.device import WireDevice
from softgrip_testing.virtual_clock import VirtualClock, VirtualRigClock

#: [s] of rig time that one exchange of bytes takes.
_EXCHANGE_TIME = 0.002


class MemoryPort(LinePort):
    """A port whose other end is a `WireDevice` in this process."""

    def __init__(self, device: WireDevice, time: VirtualRigClock) -> None:
        super().__init__("memory", mark10.BAUD)
        self._device, self._time = device, time
        self._attached = False

    @property
    def is_open(self) -> bool:
        """See `LinePort`."""
        return self._attached

    def open(self) -> None:
        """Attach the device; what it says first is there to read."""
        self._attached = True
        self._pending = b"".join(chunk.data for chunk in self._device.opened(self._time.now()))

    def close(self) -> None:
        """Detach the device."""
        self._attached = False

    def write(self, data: bytes) -> None:
        """See `LinePort`; takes 2 ms of rig time."""
        if not self._attached:
            raise PortLostError("port memory: expected it open, found it closed")
        self._time.wait(_EXCHANGE_TIME)
        self._hear(data)

    def read_line(self, timeout: float | None = None, length: int = 0) -> bytes:
        """See `LinePort`."""
        # The base class would wait on the wall clock; here what can come in time comes at once.
        while b"\n" not in self._pending and self._receive(self.reply_time if timeout is None else timeout):
            pass
        return super().read_line(0.0, length)

    def _receive(self, timeout: float) -> bool:
        due = self._device.due_s()
        if due is None or due > self._time.now() + timeout:
            return False
        self._time.wait(due - self._time.now())
        before = len(self._pending)
        self._hear(b"")
        return len(self._pending) > before

    def _hear(self, data: bytes) -> None:
        chunks = self._device.exchange(data, self._time.now(), mark10.BAUD)
        self._pending += b"".join(chunk.data for chunk in chunks)


class RigHands:
    """The person at the rig: does what is asked; ``before`` may meddle first. Keeps what was said and judged."""

    def __init__(self, rig: EmulatedRig) -> None:
        self.rig = rig
        self.steps: list[ProcedureStep] = []
        self.points: list[JudgedPoint] = []
        self.samples = 0
        self.before: Callable[[ProcedureStep], None] = lambda _: None
        self.on_sample: Callable[[RigSample], None] = lambda _: None

    def show_step(self, step: ProcedureStep) -> None:
        """Keep a step that was announced."""
        self.steps.append(step)

    def confirmed(self, step: ProcedureStep) -> None:
        """Set the angle and hang the weight that a step asks for."""
        self.steps.append(step)
        self.before(step)
        self.rig.set(step.point.angle, step.point.load)

    def judged(self, point: JudgedPoint) -> None:
        """Keep an attempt with its verdict."""
        self.points.append(point)

    def sampled(self, sample: RigSample) -> None:
        """Count a sample."""
        self.samples += 1
        self.on_sample(sample)

    def asked(self) -> list[ProcedureStep]:
        """Settings that were asked for with a weight."""
        return [step for step in self.steps if step.phase == 0 and step.point.load > 0.0]

    def accepted(self) -> list[JudgedPoint]:
        """Attempts that were accepted."""
        return [point for point in self.points if point.slide.verdict is PointVerdict.ACCEPTED]


class VirtualRig:
    """Emulated rig, driver and person in one process."""

    def __init__(self, seed: int, folder: Path, *, truth: RigTruth | None = None, stage: str = "mark10") -> None:
        clock = VirtualClock()
        self.time = VirtualRigClock(clock)
        self.rig = EmulatedRig(seed, truth=truth, clock=clock, stage=stage)
        self.hands = RigHands(self.rig)
        self.folder = folder
        port = MemoryPort(self.rig.stand, self.time)
        self.stage: Stage = GrblStage(port) if stage == "grbl" else Mark10Stand(port)
        self.gauge: Gauge = Mark10Gauge(MemoryPort(self.rig.gauge, self.time))
        self.stage.open()
        self.gauge.open()

    def procedure(self, settings: RigSettings) -> Procedure:
        """Return a measurement on this rig."""
        return Procedure(self.stage, self.gauge, self.hands, self.time, settings, self.folder)

    def stands(self) -> bool:
        """True when the stage stands still."""
        self.rig.plant.advance(self.time.now())
        return self.rig.plant.velocity == 0.0
