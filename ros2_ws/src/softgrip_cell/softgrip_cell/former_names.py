# SPDX-License-Identifier: Apache-2.0
"""Names that files and databases of earlier releases have; what is read under them is read as the present name."""

from __future__ import annotations

#: former -> present name of fields and of kinds of files
PRESENT_NAMES = {
    "hold_excess_n": "hold_contact_tension_n",
    "softgrip_passports": "softgrip_finger_records",
}


def with_present_names(values: dict[str, object]) -> dict[str, object]:
    """Return a mapping with former names of its fields replaced; a field given under both names keeps both."""
    return {
        PRESENT_NAMES[key] if key in PRESENT_NAMES and PRESENT_NAMES[key] not in values else key: value
        for key, value in values.items()
    }
