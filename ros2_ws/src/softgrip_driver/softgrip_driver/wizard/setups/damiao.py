# SPDX-License-Identifier: Apache-2.0
"""Damiao motors get their IDs with the maker's tool."""

from __future__ import annotations

from typing import NoReturn

from softgrip_driver.errors import NoSetupError


def make_setup() -> NoReturn:
    """Raise NoSetupError: says how a chain of Damiao motors comes about."""
    raise NoSetupError(
        "drive 'damiao': expected drives that get their IDs over the bus here, found Damiao motors: give each its "
        "CAN ID (1 to 15) with the maker's tool over the motor's own serial port, then write the chain into the cell "
        "file by hand (docs/cell_file.md)"
    )
