# SPDX-License-Identifier: Apache-2.0
"""What ends a shift early."""


class ShiftError(Exception):
    """The shift cannot go on; the message says what was expected, what was found and where to look."""
