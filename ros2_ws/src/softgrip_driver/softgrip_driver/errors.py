# SPDX-License-Identifier: Apache-2.0
"""What can go wrong with a device, or on a rig. Every message says what was expected, what was found and what to do."""

from __future__ import annotations

#: what to do about a servo that does not answer while others do: most often it is a plug
MISSING_SERVO_REMEDY = (
    "press in the plugs at both ends of its cable, and see that its LED flashes when the supply comes on; if they "
    "sit well it has another ID: correct its `id` in the cell file (parameter servo_ids), or give it the "
    "expected one"
)


class DriverError(Exception):
    """Base of everything this package raises on purpose."""


class ConfigurationError(DriverError):
    """The configuration contradicts itself or what the device can do."""


class NoSetupError(ConfigurationError):
    """Drives of this make are not set up here; the message says how it is done instead."""


class DeviceNotFoundError(DriverError):
    """No device where one was expected: wrong port, wrong baud rate, wrong ID, no power."""


class WrongDeviceError(DriverError):
    """A device answered, but not the one the configuration names."""


class PortLostError(DriverError):
    """The serial port went away or cannot be opened."""


class NoReplyError(DriverError):
    """A device did not answer within the time the bus allows."""


class CorruptReplyError(DriverError):
    """Bytes came back that are no valid answer: checksum, length, ID or instruction are wrong."""


class GaugeRestartedError(CorruptReplyError):
    """The gauge restarted while it was in use: its zero may be another."""


class DeviceRefusedError(DriverError):
    """The device answered that it will not do what was asked."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        #: what the device said (Dynamixel: status error code 1..7)
        self.code = code


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
