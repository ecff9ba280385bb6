# SPDX-License-Identifier: Apache-2.0
"""What ends a shift or a first run early."""


class ShiftError(Exception):
    """The shift cannot go on; the message says what was expected, what was found and where to look."""


class FirstRunError(Exception):
    """A step of the first run cannot be measured; the message says what was expected, found, and what to do."""
