# SPDX-License-Identifier: Apache-2.0
"""Bags as tables that other programs query: partitioned Parquet beside the untouched MCAP (docs/archive.md).

`Archive` adds bags to a folder or an S3 bucket, `ask` asks it in SQL, `connect` opens SQL over it. None of them needs
ROS: every message is read by the definition that its bag carries.
"""

from softgrip_bag.archive.sql import ask, connect, shipped_queries
from softgrip_bag.archive.store import Added, Archive, place_options

__all__ = ["Added", "Archive", "ask", "connect", "place_options", "shipped_queries"]
