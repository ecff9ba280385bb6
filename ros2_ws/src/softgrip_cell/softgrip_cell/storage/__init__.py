# SPDX-License-Identifier: Apache-2.0
"""The cell's memory: SQLite by default, PostgreSQL by URL, the same tables in both."""

from softgrip_cell.storage.engine import SHIPPED_URL, Database
from softgrip_cell.storage.journal import HeldLock, Journal, OpenOperation, Slot, SlotState
from softgrip_cell.storage.library import Library
from softgrip_cell.storage.pending import PendingWrites

__all__ = [
    "SHIPPED_URL",
    "Database",
    "HeldLock",
    "Journal",
    "Library",
    "OpenOperation",
    "PendingWrites",
    "Slot",
    "SlotState",
]
