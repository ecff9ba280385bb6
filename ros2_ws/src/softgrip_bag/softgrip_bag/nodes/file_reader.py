# SPDX-License-Identifier: Apache-2.0
"""Reads the files that parameters name, on a thread of its own: a file may be slow, and a recording must not wait."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue

from softgrip_bag.context import parameter_files
from softgrip_bag.errors import BagError
from softgrip_bag.mcap_file import Attachment


class FileReader:
    """Reads files one after the other.

    Args:
        roots: folders that files may be below, or files that they may be.
        found: called with each file, on the reader's thread.
    """

    def __init__(self, roots: Sequence[Path], found: Callable[[Attachment], None]) -> None:
        self._roots = roots
        self._found = found
        self._asked: SimpleQueue[tuple[str, str, str] | None] = SimpleQueue()
        self._results: SimpleQueue[tuple[tuple[str, str, str], str, bool]] = SimpleQueue()
        self._pending: set[tuple[str, str, str]] = set()
        # a daemon: a file system that never answers must not keep the process from ending
        self._thread = threading.Thread(target=self._run, name="file reader", daemon=True)
        self._thread.start()

    def request(self, node: str, parameter: str, path: str) -> None:
        """Have a file or a folder's YAML files read; one that is asked for already is not asked for twice."""
        if (node, parameter, path) not in self._pending:
            self._pending.add((node, parameter, path))
            self._asked.put((node, parameter, path))

    def results(self) -> list[tuple[tuple[str, str, str], str, bool]]:
        """Return what has been done since: (node, parameter, path), what is wrong or empty, whether to try again."""
        done = []
        while True:
            try:
                done.append(self._results.get_nowait())
            except Empty:
                break
            self._pending.discard(done[-1][0])
        return done

    def close(self) -> None:
        """End the thread after what it reads now."""
        self._asked.put(None)

    def _run(self) -> None:
        while (asked := self._asked.get()) is not None:
            node, parameter, path = asked
            problem, is_temporary = "", False
            try:
                for file in parameter_files(self._roots, node, parameter, Path(path)):
                    self._found(file)
            except OSError as error:
                problem, is_temporary = error.strerror or str(error), True
            except BagError as error:
                problem = str(error)
            except Exception as error:  # noqa: BLE001  whatever a file causes is reported and the next one is read
                problem = repr(error)
            self._results.put((asked, problem, is_temporary))
