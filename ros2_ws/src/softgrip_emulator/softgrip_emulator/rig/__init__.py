# SPDX-License-Identifier: Apache-2.0
"""The emulated friction rig: a cable over a printed surface, and the devices that pull and weigh it."""

from softgrip_emulator.rig.emulated import EmulatedRig
from softgrip_emulator.rig.truth import FrictionTruth, RigTruth

__all__ = ["EmulatedRig", "FrictionTruth", "RigTruth"]
