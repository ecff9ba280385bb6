# SPDX-License-Identifier: Apache-2.0
"""Settings for every test of the suite."""

import os
import re
from collections.abc import Callable

import pytest
from hypothesis import HealthCheck, settings

# A busy machine is no failure: no test of this suite is about time.
settings.register_profile("softgrip", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("softgrip")

# Nodes that tests make, and processes that they start, have a ROS graph of their own: a cell may be at work here.
os.environ["ROS_DOMAIN_ID"] = str(os.getpid() % 50 + 1)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

_NUMBER = re.compile(r"\d+(?:\.(\d+))?")


@pytest.fixture
def differences() -> Callable[[str, str], list[str]]:
    """Return what compares a written document with what the code gives for it.

    Compilers and processors round differently, so a number may differ by one unit of its last digit; no word may.
    """

    def lines(written: str, given: str) -> list[str]:
        left, right = written.splitlines(), given.splitlines()
        found = [] if len(left) == len(right) else [f"expected {len(right)} lines, found {len(left)}"]
        found += [f"- {a}\n+ {b}" for a, b in zip(left, right, strict=False) if not _same(a, b)]
        return found

    return lines


def _same(written: str, given: str) -> bool:
    if written == given:
        return True
    words = [" ".join(_NUMBER.sub("#", line).split()) for line in (written, given)]
    pairs = zip(_NUMBER.finditer(written), _NUMBER.finditer(given), strict=False)
    return words[0] == words[1] and all(_close(a, b) for a, b in pairs)


def _close(written: re.Match[str], given: re.Match[str]) -> bool:
    step = 10.0 ** -len(written[1] or "")
    return abs(float(written[0]) - float(given[0])) < 1.5 * step
