# SPDX-License-Identifier: Apache-2.0
"""The record of acts: who did what and what came of it, one JSON line each, on disk before the next act."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from pathlib import Path

#: A longer text of somebody else is cut.
MAX_CHARS = 2000
#: A file that has grown so large is put aside [B]; one that was put aside before is given up.
MAX_BYTES = 20_000_000


class ActRecord:
    """Appends lines to a file.

    Args:
        file: None = kept nowhere.
        now_s: seconds since the Unix epoch.
    """

    def __init__(self, file: Path | None, now_s: Callable[[], float]) -> None:
        self._file = file
        self._now_s = now_s
        self._lock = threading.Lock()
        self.problem = ""

    def write(self, who: str, act: str, subject: str, *, success: bool, message: str) -> None:
        """Write what somebody did; a disk that takes nothing is a `problem`, not an end."""
        if self._file is None:
            return
        line = {
            "at_s": round(self._now_s(), 3),
            "who": who,
            "act": act,
            "subject": subject[:MAX_CHARS],
            "success": success,
            "message": message[:MAX_CHARS],
        }
        with self._lock:
            try:
                self._append(self._file, json.dumps(line, ensure_ascii=True))
                self.problem = ""
            except OSError as error:
                self.problem = f"record of acts {self._file}: expected to write it, found {error}"

    def _append(self, file: Path, line: str) -> None:
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.exists() and file.stat().st_size > MAX_BYTES:
            file.replace(file.with_suffix(".1.jsonl"))
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        try:
            os.write(descriptor, f"{line}\n".encode())
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
