# SPDX-License-Identifier: Apache-2.0
"""The tables. Times are nanoseconds since the Unix epoch (UTC); documents are JSON text."""

from __future__ import annotations

from typing import Final

from sqlalchemy import BigInteger, Boolean, Column, Float, Index, Integer, MetaData, String, Table, Text

#: Grows when a table changes; a database with a greater number is refused.
SCHEMA_VERSION: Final = 3

#: Versions that lack nothing but tables, which are added when such a database is opened.
EXTENSIBLE_VERSIONS: Final = frozenset({1, 2})

#: Longest texts of the audit table.
WHO_LENGTH: Final = 80
ACTION_LENGTH: Final = 40
SUBJECT_LENGTH: Final = 160

METADATA: Final = MetaData()

META = Table(
    "softgrip_meta", METADATA, Column("key", String(40), primary_key=True), Column("value", Text, nullable=False)
)

#: Every version of every product, finger set; the greatest version is the one in force. Rows are never changed.
ENTRY = Table(
    "softgrip_entry",
    METADATA,
    Column("kind", String(20), primary_key=True),  # "product" or "finger_set"
    Column("id", String(80), primary_key=True),
    Column("version", Integer, primary_key=True),
    Column("document", Text, nullable=False),
    Column("who", String(80), nullable=False),
    Column("at_ns", BigInteger, nullable=False),
)

FINGER_RECORD = Table(
    "softgrip_passport",
    METADATA,
    Column("serial", String(80), primary_key=True),
    Column("profile", String(80), nullable=False),
    Column("finger", String(40), nullable=False),
    Column("printed", String(10), nullable=False),
    Column("material", String(80), nullable=False),
    Column("cable", String(80), nullable=False),
    Column("state", String(20), nullable=False),
    Column("cycles", Integer, nullable=False),
    Column("cycle_limit", Integer, nullable=False),
    Column("calibrated", String(10)),
    Column("reference", Text),  # free motion as the last passed empty closing saw it
    Column("version", Integer, nullable=False),
)

SLOT = Table(
    "softgrip_slot",
    METADATA,
    Column("slot", String(40), primary_key=True),
    Column("serial", String(80), nullable=False),  # empty when none is known
    Column("state", String(20), nullable=False),
)

#: At most one row: the swap or grasp that is going on. A row found at start tells that the manager died in it.
OPERATION = Table(
    "softgrip_operation",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("kind", String(20), nullable=False),
    Column("subject", String(80), nullable=False),
    Column("step", String(40), nullable=False),
    Column("at_ns", BigInteger, nullable=False),
)

#: At most one row: the lock of the drives that this cell holds (tendon/lock). Hands may be inside until it is released.
LOCK = Table(
    "softgrip_lock",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("token", String(200), nullable=False),  # of tendon/lock
    Column("confirm_token", String(80), nullable=False),  # of the swap, for cell/confirm_step
    Column("subject", String(80), nullable=False),
    Column("at_ns", BigInteger, nullable=False),
)

OUTCOME = Table(
    "softgrip_outcome",
    METADATA,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("product", String(80), nullable=False),
    Column("product_version", Integer, nullable=False),
    Column("finger_set", String(80), nullable=False),
    Column("outcome", String(20), nullable=False),
    Column("reason", Text, nullable=False),
    Column("duration_s", Float, nullable=False),
    Column("at_ns", BigInteger, nullable=False),
    Index("softgrip_outcome_by_product", "product", "finger_set"),
)

#: Which fingers grasped, and by what it was decided; none of a grasp that an older release counted.
GRASP_EVIDENCE = Table(
    "softgrip_grasp_evidence",
    METADATA,
    Column("outcome_id", Integer, primary_key=True, autoincrement=False),
    Column("serials", Text, nullable=False),  # list, slot order
    Column("decided_ns", BigInteger, nullable=False),  # of the sample that decided; 0 when none did
    Column("phase", String(20), nullable=False),  # in which it was decided; empty when it was not
    Column("fingers", Text, nullable=False),  # list of what the verdict knew of each, slot order
)

SWAP = Table(
    "softgrip_swap",
    METADATA,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("finger_set", String(80), nullable=False),
    Column("outcome", String(20), nullable=False),
    Column("counted", Boolean, nullable=False),  # fingers were changed and verified
    Column("reason", Text, nullable=False),
    Column("duration_s", Float, nullable=False),
    Column("at_ns", BigInteger, nullable=False),
)

AUDIT = Table(
    "softgrip_audit",
    METADATA,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("at_ns", BigInteger, nullable=False),
    Column("who", String(WHO_LENGTH), nullable=False),
    Column("action", String(ACTION_LENGTH), nullable=False),
    Column("subject", String(SUBJECT_LENGTH), nullable=False),
    Column("detail", Text, nullable=False),
)
