# SPDX-License-Identifier: Apache-2.0
"""The driver's rig code on the emulated rig in virtual time: the same bytes, no pseudo-terminals, no waiting.

Used by rig_coverage and by the driver's tests, so that fifty calibrations take seconds and never depend on the machine.
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

#: [s] of rig time that one exchange of bytes takes.
_EXCHANGE_TIME = 0.002


class VirtualTime:
    """Rig time that passes only when somebody waits or talks; a `RigClock` and the emulator's clock in one."""

    scale = 1.0

    def __init__(self) -> None:
        self._time = 0.0
        self.stopped = False

    def now(self) -> float:
        """Rig time [s]."""
        return self._time

    def now_s(self) -> float:
        """Rig time [s], as the emulator asks for it."""
        return self._time

    def wait(self, duration: float) -> bool:
        """Let time pass [s]; True when stopped."""
        self._time += max(duration, 0.0)
        return self.stopped

    def stop(self) -> None:
        """End all waits."""
        self.stopped = True


class MemoryPort(LinePort):
    """A port whose other end is a `WireDevice` in this process."""

    def __init__(self, device: WireDevice, time: VirtualTime) -> None:
        super().__init__("memory", mark10.BAUD)
        self._device, self._time = device, time
        self._attached = False

    @property
    def is_open(self) -> bool:
        return self._attached

    def open(self) -> None:
        self._attached = True
        self._pending = b"".join(chunk.data for chunk in self._device.opened(self._time.now()))

    def close(self) -> None:
        self._attached = False

    def write(self, data: bytes) -> None:
        if not self._attached:
            raise PortLostError("port memory: expected it open, found it closed")
        self._time.wait(_EXCHANGE_TIME)
        self._hear(data)

    def read_line(self, timeout: float | None = None) -> bytes:
        # The base class would wait on the wall clock; here what can come in time comes at once.
        while b"\n" not in self._pending and self._receive(self.reply_time if timeout is None else timeout):
            pass
        return super().read_line(0.0)

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


class Hands:
    """The person at the rig: does what is asked; ``before`` may meddle first. Keeps what was said and judged."""

    def __init__(self, rig: EmulatedRig) -> None:
        self.rig = rig
        self.steps: list[ProcedureStep] = []
        self.points: list[JudgedPoint] = []
        self.samples = 0
        self.before: Callable[[ProcedureStep], None] = lambda _: None
        self.on_sample: Callable[[RigSample], None] = lambda _: None

    def tell(self, step: ProcedureStep) -> None:
        self.steps.append(step)

    def confirmed(self, step: ProcedureStep) -> None:
        self.steps.append(step)
        self.before(step)
        self.rig.set(step.point.angle, step.point.load)

    def judged(self, point: JudgedPoint) -> None:
        self.points.append(point)

    def sampled(self, sample: RigSample) -> None:
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
        self.time = VirtualTime()
        self.rig = EmulatedRig(seed, truth=truth, clock=self.time, stage=stage)
        self.hands = Hands(self.rig)
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
