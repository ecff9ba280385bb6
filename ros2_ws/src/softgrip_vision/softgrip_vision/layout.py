# SPDX-License-Identifier: Apache-2.0
"""What is painted on a finger: a chain of round markers, base to tip; and the chains that profiles describe."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from softgrip_model.profile import Profile, ProfileError, load_directory, shipped_directory
from softgrip_vision.errors import LayoutError

#: [rad] A joint cannot open further than this, nor close further (the groove closes at 90 deg; finger.md 2).
JOINT_RANGE = (-0.35, 1.75)


@dataclass(frozen=True)
class ChainLayout:
    """The markers of one finger: one behind the first joint, one on every joint's apex, one on the tip.

    Attributes:
        link_lengths_m: (n,) [m] joint to joint, the last one joint to tip; n = number of joints.
    """

    link_lengths_m: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.link_lengths_m or not all(0.001 <= length <= 1.0 for length in self.link_lengths_m):
            raise LayoutError(f"expected link lengths of 0.001 .. 1 m, found {list(self.link_lengths_m)}")

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.link_lengths_m)

    @cached_property
    def marker_names(self) -> tuple[str, ...]:
        """Names of the markers, base to tip."""
        return ("base", *(f"joint_{j}" for j in range(self.joints)), "tip")


#: Profile id -> finger -> what is painted on it.
Chains = Mapping[str, Mapping[str, ChainLayout]]


@dataclass(frozen=True)
class FingerSetup:
    """One finger that the tracker looks for.

    Attributes:
        name: of the finger.
        hue_deg: [deg] colour of its markers on the HSV circle (green = 120).
        region: (left, top, width, height) [px] it is looked for in; None = the whole image.
    """

    name: str
    hue_deg: float = 120.0
    region: tuple[int, int, int, int] | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(self.hue_deg) or not 0 <= self.hue_deg < 360:
            raise LayoutError(f"finger '{self.name}': expected a hue of 0 .. 360 deg, found {self.hue_deg}")
        if self.region is not None and (min(self.region[:2]) < 0 or min(self.region[2:]) <= 0):
            raise LayoutError(f"finger '{self.name}': expected a region with positive size, found {self.region}")


def parse_region(text: str) -> tuple[int, int, int, int] | None:
    """Return (left, top, width, height) [px] of text like ``0 120 640 360``; None of an empty one.

    Raises:
        LayoutError: when it is not four whole numbers.
    """
    words = text.split()
    if not words:
        return None
    if len(words) != 4 or not all(word.isdigit() for word in words):
        raise LayoutError(f"expected a region 'LEFT TOP WIDTH HEIGHT' in whole pixels, found {text!r}")
    left, top, width, height = (int(word) for word in words)
    return left, top, width, height


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
