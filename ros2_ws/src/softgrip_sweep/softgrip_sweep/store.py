# SPDX-License-Identifier: Apache-2.0
"""A folder of results, one file a task: what is there need not be done again.

results/<key>.json    function, arguments, result
failures/<key>.json   function, arguments, error; removed when the task succeeds later
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from softgrip_model.durable import write_durably
from softgrip_sweep.errors import SweepError
from softgrip_sweep.task import SweepTask


class ResultsStore:
    """Results on disk; a file is whole or absent, whenever the process is killed.

    Args:
        folder: made when it is missing.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def has(self, task: SweepTask) -> bool:
        """Whether the result of a task is there."""
        return self._result(task).exists()

    def save(self, task: SweepTask, result: Any) -> None:
        """Keep a result (plain values)."""
        self._write(self._result(task), task, {"result": result})
        self._failure(task).unlink(missing_ok=True)

    def save_failure(self, task: SweepTask, error: str) -> None:
        """Keep why a task failed; it will be tried again by the next sweep."""
        self._write(self._failure(task), task, {"error": error})

    def load(self, task: SweepTask) -> Any:
        """Return the result of a task.

        Raises:
            SweepError: it is not there, or no result.
        """
        return self._read(self._result(task), "result")

    def failure(self, task: SweepTask) -> str | None:
        """Return why a task failed when it was last tried; None when it did not."""
        path = self._failure(task)
        return str(self._read(path, "error")) if path.exists() else None

    def _result(self, task: SweepTask) -> Path:
        return self.folder / "results" / f"{task.key}.json"

    def _failure(self, task: SweepTask) -> Path:
        return self.folder / "failures" / f"{task.key}.json"

    def _write(self, path: Path, task: SweepTask, outcome: dict[str, Any]) -> None:
        document = {"function": task.function, "arguments": dict(task.arguments), **outcome}
        try:
            write_durably(path, json.dumps(document, indent=1).encode())
        except OSError as error:
            raise SweepError(f"{path}: cannot be written: {error.strerror}; choose another --results") from error

    def _read(self, path: Path, name: str) -> Any:
        try:
            return json.loads(path.read_text())[name]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SweepError(
                f"{path}: expected a result of a sweep, found {error}; delete it to do it again"
            ) from error
