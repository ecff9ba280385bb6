# SPDX-License-Identifier: Apache-2.0
"""Runs the steps of a first run, one after the other, and keeps what each of them came to."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from softgrip_cell.errors import CellError
from softgrip_demo.errors import FirstRunError, ShiftError
from softgrip_demo.first_run.figures import Figure, StepReport, StepStatus
from softgrip_demo.first_run.record import FirstRunRecord, save_record
from softgrip_description.cell_file import CellFile
from softgrip_driver.errors import DriverError, NoSetupError
from softgrip_vision.errors import VisionError

#: what a step may end with: each says what was expected, what was found, what to do
EXPECTED_ERRORS = (FirstRunError, ShiftError, DriverError, VisionError, CellError, OSError)


class CheckStep(Protocol):
    """One step of the checklist."""

    @property
    def key(self) -> str:
        """Short name, for the record and the command line."""

    @property
    def title(self) -> str:
        """Name for people."""

    @property
    def needs(self) -> Collection[str]:
        """Sections of the cell file that it needs: "servos", "camera", "rig"."""

    def measure(self) -> Iterator[Figure]:
        """Yield figures beside their bounds; raises one of EXPECTED_ERRORS where it cannot go on."""


class Checklist:
    """The steps of a first run.

    Args:
        steps: in order; a bad one ends the run, since the next ones build on it.
        record: of an earlier session.
        path: that the record is kept at.
        say: told what happens, in lines.
    """

    def __init__(
        self, steps: Sequence[CheckStep], record: FirstRunRecord, path: Path, say: Callable[[str], object]
    ) -> None:
        self._steps, self.record, self._path, self._say = steps, record, path, say

    def run(self, cell: CellFile, again: Collection[str] = ()) -> FirstRunRecord:
        """Do every step that is not done, and those named ``again``; return the record."""
        for step in self._steps:
            if self.record.is_done(step.key) and step.key not in again:
                self._say(f"[done] {step.title}")
                continue
            report = self._left_out(step, cell) or self._measured(step)
            self.record = self.record.with_report(report)
            save_record(self.record, self._path)
            self._tell(report)
            if report.status is StepStatus.BAD:
                break
        return self.record

    def _left_out(self, step: CheckStep, cell: CellFile) -> StepReport | None:
        lacking = [name for name in step.needs if getattr(cell, name) is None]
        if not lacking:
            return None
        problem = f"the cell file has no {' and no '.join(lacking)}"
        return StepReport(step.key, step.title, StepStatus.LEFT_OUT, (), problem, _now())

    def _measured(self, step: CheckStep) -> StepReport:
        self._say(f"[....] {step.title}")
        figures: list[Figure] = []
        problem = ""
        try:
            figures.extend(step.measure())
        except NoSetupError as error:
            return StepReport(step.key, step.title, StepStatus.LEFT_OUT, tuple(figures), str(error), _now())
        except EXPECTED_ERRORS as error:
            problem = str(error)
        is_good = not problem and all(figure.is_good for figure in figures)
        status = StepStatus.GOOD if is_good else StepStatus.BAD
        return StepReport(step.key, step.title, status, tuple(figures), problem, _now())

    def _tell(self, report: StepReport) -> None:
        self._say(f"[{report.status.value:^8}] {report.title}")
        if report.status is StepStatus.LEFT_OUT and report.problem:
            self._say(f"  -- {report.problem}")
        for figure in report.figures:
            self._say(f"    {'ok' if figure.is_good else '!!'}  {figure.name}: {figure.found} ({figure.bound})")
        for remark in report.remarks:
            self._say(f"  -- {remark}")
        for complaint in report.complaints:
            self._say(f"  -> {complaint}")


def _now() -> str:
    return datetime.now(tz=UTC).isoformat(timespec="seconds")
