# SPDX-License-Identifier: Apache-2.0
"""The marker chains of the fingers that finger profiles describe."""

from __future__ import annotations

from pathlib import Path

from softgrip_model.profile import Profile, ProfileError, load_directory, shipped_directory
from softgrip_vision.errors import LayoutError
from softgrip_vision.layout import ChainLayout, Chains


def chains_of(profile: Profile) -> dict[str, ChainLayout]:
    """Return slot -> chain of the fingers of one profile."""
    return {slot: ChainLayout(design.link_lengths_m) for slot, design in profile.fingers}


def read_chains(directory: Path | None) -> Chains:
    """Return profile id -> slot -> chain of the profiles in a folder; None = those of softgrip_bringup.

    Raises:
        LayoutError: when there are none, or one of them cannot be used.
    """
    try:
        profiles = load_directory(directory or shipped_directory())
        return {name: chains_of(profile) for name, profile in profiles.items()}
    except ProfileError as error:
        raise LayoutError(str(error)) from error
