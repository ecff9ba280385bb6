# SPDX-License-Identifier: Apache-2.0
"""What can go wrong on a rig beyond what every device has (softgrip_driver.errors)."""

from __future__ import annotations

from softgrip_driver.errors import DeviceRefusedError, DriverError


class SaturatedError(DriverError):
    """The gauge is at the end of its range: the force is unknown."""


class UnitChangedError(DriverError):
    """Somebody switched the gauge's unit at its panel: its numbers mean something else."""


class GaugeFaultError(DriverError):
    """The gauge does not feel what is known to hang on it."""


class NotReadyError(DeviceRefusedError):
    """The device still ends what it did before; ask again."""


class LimitError(DriverError):
    """A force or travel limit was reached, or would be."""


class StageStalledError(DriverError):
    """The stage was told to move and does not."""


class StoppedError(DriverError):
    """The measurement was stopped by request."""


class JournalError(DriverError):
    """The record of a plan cannot be written or read."""
