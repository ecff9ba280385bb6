# SPDX-License-Identifier: Apache-2.0
"""Counts the checks that hold against a peer."""

from __future__ import annotations


class Checks:
    """Counts what holds."""

    def __init__(self) -> None:
        self.done = 0
        self.failed: list[str] = []

    def __call__(self, name: str, *, holds: bool, found: object = "") -> None:
        """Count a check."""
        self.done += 1
        if not holds:
            self.failed.append(f"{name}: found {found}")

    def report(self, subject: str, ending: str = "") -> int:
        """Print how many hold, and those that do not; return the exit code."""
        print(f"{subject}: {self.done - len(self.failed)} of {self.done} checks hold{ending}")
        for text in self.failed:
            print(f"  {text}")
        return 1 if self.failed else 0
