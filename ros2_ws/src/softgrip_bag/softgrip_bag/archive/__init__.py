# SPDX-License-Identifier: Apache-2.0
"""Bags as tables that other programs query: partitioned Parquet beside the untouched MCAP (docs/archive.md).

`Archive` adds bags to a folder or an S3 bucket, `connect` opens SQL over it. Neither needs ROS: every message is read
by the definition that its bag carries.
"""

from softgrip_bag.archive.sql import connect, shipped_queries
from softgrip_bag.archive.store import Added, Archive, place_options

__all__ = ["Added", "Archive", "connect", "place_options", "shipped_queries"]
