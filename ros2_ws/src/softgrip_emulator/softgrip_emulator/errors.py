# SPDX-License-Identifier: Apache-2.0
"""The errors of this package."""


class EmulatorError(Exception):
    """The emulated cell was asked for something it cannot be; the message says what was expected, found, what to do."""
