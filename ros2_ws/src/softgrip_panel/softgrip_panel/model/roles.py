# SPDX-License-Identifier: Apache-2.0
"""Roles of people, the same three as in softgrip_security's access.yaml; and who somebody is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Role(IntEnum):
    """What a person may do; a greater role may do all that a smaller one may."""

    LOOK = 1
    OPERATE = 2
    ENGINEER = 3

    @property
    def word(self) -> str:
        """The role's name as users files and pages write it."""
        return self.name.lower()


@dataclass(frozen=True)
class Person:
    """Somebody at the panel.

    Attributes:
        session: names the log-in; two log-ins of one person are two sessions.
        name: goes into the record of acts.
        role: what they may do.
    """

    session: str
    name: str
    role: Role
