# SPDX-License-Identifier: Apache-2.0
"""What tables and archives of bags are made with, and no rosdep key installs: imported when it is asked for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from softgrip_bag.errors import BagError

MODULES: Final = ("pyarrow", "duckdb", "fsspec")
INSTALL: Final = f"python3 -m pip install {' '.join(MODULES)}"


@contextmanager
def importing(purpose: str) -> Iterator[None]:
    """Say what to install where an import inside the context finds none of `MODULES`.

    Args:
        purpose: what they are needed for, as the message begins.

    Raises:
        BagError: one of them is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in MODULES:
            raise
        raise BagError(
            f"{purpose}: expected {', '.join(MODULES)}, found no module {error.name!r}; type `{INSTALL}` "
            "(recording, replay and reports do without)"
        ) from error
