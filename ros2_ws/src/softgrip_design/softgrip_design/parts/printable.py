# SPDX-License-Identifier: Apache-2.0
"""What keeps the fingers of a profile from being made, by the rules of `parts`; without making a solid."""

from __future__ import annotations

from softgrip_description.errors import HandError
from softgrip_description.hand import Hand
from softgrip_design.parts.forms import PartError
from softgrip_design.parts.kit import fingers_of
from softgrip_model.profile import Profile


def problems_of(profile: Profile, hand: Hand) -> dict[str, str]:
    """Return finger -> why `parts` refuses it for a hand, of those that it refuses."""
    found = {}
    for slot in profile.slots:
        try:
            fingers_of(profile, hand, [slot])
        except (HandError, PartError) as error:
            found[slot] = str(error)
    return found
