# SPDX-License-Identifier: Apache-2.0
"""The bags of a folder: what is there, how much room is left, and reports and replays of one at a time."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from softgrip_panel.errors import PanelError
from softgrip_panel.texts import say

#: Names of folders and files that are offered; nothing else is ever joined to a path.
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,200}")
#: A report or replay takes no longer [s].
JOB_LIMIT_S: Final = 1800.0
#: What replays are made through, and so what a verdict is about.
REPLAYED: Final = "kinematics_predictor"


@dataclass(frozen=True)
class BagView:
    """One bag.

    Attributes:
        name: of its folder.
        files: names and sizes [B].
        at_s: when it was written last, in seconds since the Unix epoch.
        has_report: whether a report stands beside it.
    """

    name: str
    files: tuple[tuple[str, int], ...]
    at_s: float
    has_report: bool

    @property
    def size(self) -> int:
        """All files [B]."""
        return sum(size for _, size in self.files)


class BagFolder:
    """Reads a folder of bags.

    Args:
        root: the folder, None = the panel was told none.
    """

    def __init__(self, root: Path | None) -> None:
        self.root = root

    def bags(self) -> tuple[BagView, ...]:
        """Return the bags, newest first."""
        if self.root is None or not self.root.is_dir():
            return ()
        found = [
            self._bag(folder) for folder in self.root.iterdir() if folder.is_dir() and _NAME.fullmatch(folder.name)
        ]
        return tuple(sorted((bag for bag in found if bag.files), key=lambda bag: -bag.at_s))

    def free_bytes(self) -> int | None:
        """Return the room that is left on the disk [B]; None where there is no folder."""
        return shutil.disk_usage(self.root).free if self.root is not None and self.root.is_dir() else None

    def file(self, bag: str, name: str) -> Path:
        """Return the path of a bag's file.

        Raises:
            PanelError: it is not among the files of a bag of this folder.
        """
        known = next((one for one in self.bags() if one.name == bag), None)
        if known is None or self.root is None or name not in dict(known.files):
            raise PanelError(say("error.bag_file", bag=bag, name=name))
        return self.root / bag / name

    def report(self, bag: str) -> Path:
        """Return where a bag's report stands, or would.

        Raises:
            PanelError: there is no such bag.
        """
        if self.root is None or bag not in {one.name for one in self.bags()}:
            raise PanelError(say("error.bag", bag=bag))
        return self.root / f"{bag}-report.html"

    def _bag(self, folder: Path) -> BagView:
        stats = [
            (file.name, file.stat()) for file in sorted(folder.iterdir()) if file.is_file() and not file.is_symlink()
        ]
        files = tuple((name, stat.st_size) for name, stat in stats if _NAME.fullmatch(name))
        at_s = max((stat.st_mtime for _, stat in stats), default=0.0)
        return BagView(folder.name, files, at_s, (folder.parent / f"{folder.name}-report.html").is_file())


@dataclass(frozen=True)
class BagJob:
    """A report or replay that runs or has ended; `kind` is "report" or "replay"."""

    bag: str
    kind: str
    is_running: bool
    message: str = ""


class BagJobs:
    """Makes reports and replays, one at a time, behind everything else that the machine does.

    Args:
        folder: of the bags.
    """

    def __init__(self, folder: BagFolder) -> None:
        self.folder = folder
        self._jobs: dict[tuple[str, str], BagJob] = {}
        self._turn = asyncio.Lock()

    def find(self, bag: str, kind: str) -> BagJob | None:
        """Return the newest job of a kind of a bag."""
        return self._jobs.get((bag, kind))

    async def run(self, bag: str, kind: str) -> BagJob:
        """Make a report or a replay and wait for its end."""
        running = self._jobs.get((bag, kind))
        if running is not None and running.is_running:
            return running
        job = self._jobs[bag, kind] = BagJob(bag, kind, is_running=True)
        try:
            report = self.folder.report(bag)
            assert self.folder.root is not None
            folder = str(self.folder.root / bag)
            words = (
                ["report", folder, "-o", str(report)]
                if kind == "report"
                else ["replay", "--through", REPLAYED, "--json", folder]
            )
            async with self._turn:
                code, out = await _ended(["nice", "-n", "19", "ros2", "run", "softgrip_bag", *words])
            message = _verdict(code, out) if kind == "replay" else ("" if code == 0 else out[-500:])
        except (PanelError, OSError, TimeoutError) as error:
            message = str(error) or say("error.job_late")
        self._jobs[bag, kind] = done = replace(job, is_running=False, message=message)
        return done


async def _ended(words: Sequence[str]) -> tuple[int, str]:
    process = await asyncio.create_subprocess_exec(
        *words, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT, stdin=asyncio.subprocess.DEVNULL
    )
    try:
        out, _ = await asyncio.wait_for(process.communicate(), JOB_LIMIT_S)
    except TimeoutError:
        process.kill()
        raise
    return process.returncode or 0, out.decode("utf-8", "replace")


def _verdict(code: int, out: str) -> str:
    """Return the replay's own words: its figures where it made some, else the end of what it said."""
    start = out.find("{")
    try:
        figures = json.loads(out[start:])
    except ValueError:
        return out.strip()[-300:]
    said = ", ".join(f"{key}: {value}" for key, value in figures.items() if isinstance(value, (int, float, str)))
    return f"{say('bags.identical' if code == 0 else 'bags.differs')}: {said}"[:400]
