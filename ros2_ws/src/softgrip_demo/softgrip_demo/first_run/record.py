# SPDX-License-Identifier: Apache-2.0
"""What is known of a first run, kept after every step, so that it goes on where it was left; signed at its end."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from softgrip_demo.errors import FirstRunError
from softgrip_demo.first_run.figures import Figure, StepReport, StepStatus
from softgrip_model.digest import text_sha256
from softgrip_model.durable import write_durably

SCHEMA = 1


@dataclass(frozen=True)
class FirstRunRecord:
    """A first run.

    Attributes:
        cell_file: path; cell_digest: SHA-256 of its text, which the reports hold for.
        reports: by step.
        name: who ran it; signed_at: UTC, ISO 8601; both empty until it is signed.
        is_emulated: some of it was done on an emulated bench, which proves nothing of real devices.
    """

    cell_file: str
    cell_digest: str
    reports: Mapping[str, StepReport] = field(default_factory=dict)
    name: str = ""
    signed_at: str = ""
    is_emulated: bool = False

    def with_report(self, report: StepReport) -> FirstRunRecord:
        """Return the record with another report; a signature no longer holds."""
        return replace(self, reports={**self.reports, report.key: report}, name="", signed_at="")

    def on_emulated_bench(self) -> FirstRunRecord:
        """Return the record as one of an emulated bench; a signature of before no longer holds."""
        return self if self.is_emulated else replace(self, is_emulated=True, name="", signed_at="")

    def is_done(self, key: str) -> bool:
        """Whether a step need not be done again."""
        return key in self.reports and self.reports[key].status is not StepStatus.BAD

    @property
    def is_good(self) -> bool:
        """Whether no step is bad."""
        return all(report.status is not StepStatus.BAD for report in self.reports.values())

    @property
    def remarks(self) -> list[str]:
        """What a reader must know of figures that are within their bounds, of every step."""
        return [remark for report in self.reports.values() for remark in report.remarks]

    @property
    def digest(self) -> str:
        """SHA-256 of all that the page shows, name and time included: another figure makes another digest."""
        return text_sha256(json.dumps(_document(self), sort_keys=True))


def load_record(path: Path, cell_file: Path) -> FirstRunRecord:
    """Return the record of an earlier session; an empty one where there is none, or the cell file was changed since.

    Raises:
        FirstRunError: the record or the cell file cannot be read.
    """
    try:
        empty = FirstRunRecord(str(cell_file.resolve()), text_sha256(cell_file.read_text(encoding="utf-8")))
        if not path.exists():
            return empty
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["schema"] != SCHEMA or data["cell_digest"] != empty.cell_digest:
            return empty
        reports = {row["key"]: _report(row) for row in data["reports"]}
        is_emulated = bool(data.get("is_emulated", False))
        return replace(empty, reports=reports, name=data["name"], signed_at=data["signed_at"], is_emulated=is_emulated)
    except (OSError, UnicodeDecodeError, ValueError, KeyError, TypeError) as error:
        raise FirstRunError(
            f"{path}: expected the record of a first run, found: {error!r}; delete it to begin from the first step"
        ) from error


def save_record(record: FirstRunRecord, path: Path) -> None:
    """Write the record whole, or not at all; raises OSError."""
    write_durably(path, json.dumps(_document(record) | {"digest": record.digest}, indent=1).encode())


def _document(record: FirstRunRecord) -> dict[str, object]:
    return {
        "schema": SCHEMA,
        "cell_file": record.cell_file,
        "cell_digest": record.cell_digest,
        "reports": [_row(report) for report in record.reports.values()],
        "name": record.name,
        "signed_at": record.signed_at,
        # named only where it is so: signatures of records from before there was the name go on to hold
        **({"is_emulated": True} if record.is_emulated else {}),
    }


def _row(report: StepReport) -> dict[str, object]:
    row = asdict(report)
    for figure in row["figures"]:
        if not figure["remark"]:  # as with is_emulated
            del figure["remark"]
    return row


def _report(row: Mapping[str, Any]) -> StepReport:
    figures = tuple(Figure(**figure) for figure in row["figures"])
    return StepReport(**{**row, "status": StepStatus(row["status"]), "figures": figures})


def render(record: FirstRunRecord) -> str:
    """Return the page, self-contained HTML; everything from outside is escaped."""
    environment = Environment(
        loader=PackageLoader("softgrip_demo"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template("first_run.html.j2").render(record=record, reports=[*record.reports.values()])
