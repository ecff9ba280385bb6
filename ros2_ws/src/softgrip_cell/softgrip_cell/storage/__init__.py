# SPDX-License-Identifier: Apache-2.0
"""The cell's memory: SQLite by default, PostgreSQL by URL, the same tables in both."""

from softgrip_cell.storage.engine import SHIPPED_URL, Database
from softgrip_cell.storage.journal import Journal, OpenOperation, Slot, SlotState
from softgrip_cell.storage.library import Library

__all__ = ["SHIPPED_URL", "Database", "Journal", "Library", "OpenOperation", "Slot", "SlotState"]
