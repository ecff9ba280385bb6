# SPDX-License-Identifier: Apache-2.0
"""The cell's memory: SQLite by default, PostgreSQL by URL, the same tables in both."""

from softgrip_cell.storage.engine import SHIPPED_URL, Database
from softgrip_cell.storage.journal import CellJournal, HeldLock, MountedSlot, OpenOperation, SlotState
from softgrip_cell.storage.library import Library
from softgrip_cell.storage.pending import PendingWrites

__all__ = [
    "SHIPPED_URL",
    "CellJournal",
    "Database",
    "HeldLock",
    "Library",
    "MountedSlot",
    "OpenOperation",
    "PendingWrites",
    "SlotState",
]
