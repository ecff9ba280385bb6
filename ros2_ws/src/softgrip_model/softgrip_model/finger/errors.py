# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with a finger; a message says what was expected, what was found and what to do."""

from __future__ import annotations


class FingerError(ValueError):
    """A design, a law or a request that the kernel cannot compute."""
