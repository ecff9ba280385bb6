# SPDX-License-Identifier: Apache-2.0
"""rig/progress: where the guided measurement stands, for whoever has not followed it from its beginning."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from softgrip_driver.errors import JournalError
from softgrip_driver.rig.journal import PlanJournal
from softgrip_driver.rig.procedure import ProcedureStep
from softgrip_interfaces.action import CalibrateFriction
from softgrip_interfaces.msg import FrictionSample, RigProgress


class ProgressLog:
    """Keeps the progress of the present or last measurement, and publishes each change.

    Args:
        publish: sends rig/progress, stamped.
        reason: what there is to say before the first measurement.
    """

    def __init__(self, publish: Callable[[RigProgress], object], reason: str) -> None:
        self._publish = publish
        self._lock = threading.Lock()  # measuring and confirming run in different threads
        self._progress = RigProgress(reason=reason)
        self._publish(self._progress)

    def publish_start(self) -> None:
        """Publish that a measurement begins."""
        with self._lock:
            self._progress = RigProgress(running=True, phase=CalibrateFriction.Feedback.CHECKING)
            self._publish(self._progress)

    def publish_step(self, step: ProcedureStep, *, needs_confirmation: bool) -> None:
        """Publish a step of it."""
        with self._lock:
            progress = self._progress
            progress.phase, progress.confirmation = int(step.phase), needs_confirmation
            progress.index, progress.total = int(step.index), int(step.total)
            progress.angle, progress.load = float(step.point.angle), float(step.point.load)
            progress.instruction = step.instruction
            self._publish(progress)

    def confirm(self) -> None:
        """Publish that the person has confirmed."""
        with self._lock:
            self._progress.confirmation = False
            self._publish(self._progress)

    def judge(self, sample: FrictionSample) -> None:
        """Publish one more judged attempt."""
        with self._lock:
            self._progress.samples = [*self._progress.samples, sample]
            self._publish(self._progress)

    def end(self, result: CalibrateFriction.Result) -> None:
        """Publish the end."""
        with self._lock:
            progress = self._progress
            progress.running = progress.confirmation = False
            progress.instruction = ""
            progress.outcome, progress.reason, progress.model = result.outcome, result.reason, result.model.id
            self._publish(progress)


def broken_plan_text(folder: Path) -> str:
    """Return in words which plan was broken off and can be resumed, empty for none."""
    try:
        journal = PlanJournal.last_broken(folder)
    except JournalError as error:
        return str(error)
    if journal is None:
        return ""
    return f"plan {journal.plan_id} was broken off after {len(journal.points)} points: resume it, or begin another"
