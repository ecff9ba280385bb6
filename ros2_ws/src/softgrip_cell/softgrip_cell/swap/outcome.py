# SPDX-License-Identifier: Apache-2.0
"""How a swap of fingers ended."""

from __future__ import annotations

from enum import IntEnum


class SwapOutcome(IntEnum):
    """How a swap ended (outcome of SwapFingers.Result); stored by name."""

    UNSET = 0
    SUCCEEDED = 1
    CANCELLED = 2
    REFUSED = 3
    FAILED = 4
