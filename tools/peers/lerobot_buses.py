# SPDX-License-Identifier: Apache-2.0
r"""LeRobot's Dynamixel or Feetech bus against emulated servos: how many checks hold, and which do not.

In an environment of its own (Python 3.12), with LeRobot's source; PyTorch is not needed:

    git clone https://github.com/huggingface/lerobot && python3.12 -m venv /tmp/lerobot
    /tmp/lerobot/bin/pip install dynamixel-sdk==3.8.4 feetech-servo-sdk pyserial deepdiff tqdm draccus numpy \
        huggingface_hub
    python tools/peers/serve.py /tmp/servos XL330-M288 &
    PYTHONPATH=lerobot/src /tmp/lerobot/bin/python tools/peers/lerobot_buses.py /tmp/servos xl330-m288

The table, the encodings and the order of the instructions are LeRobot's; so is what a written value must read back as.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from unittest import mock

# The buses do without PyTorch; lerobot.utils, which they import, names its types.
sys.modules.setdefault("torch", mock.MagicMock())

from lerobot.motors import Motor, MotorNormMode  # noqa: E402
from lerobot.motors.dynamixel import DynamixelMotorsBus  # noqa: E402
from lerobot.motors.feetech import FeetechMotorsBus  # noqa: E402

TIMEOUT_MS = 2000.0
NAMES = ("one", "two", "three")
#: items whose new value would end the conversation or start a motion, beside those that a servo refuses to change
UNTOUCHED = {"ID", "Baud_Rate", "Baud_Rate_2", "Torque_Enable", "Status_Return_Level", "Response_Status_Level",
             "Protocol_Type", "Operating_Mode", "Drive_Mode", "Lock", "Secondary_ID", "Bus_Watchdog",
             "Goal_Position_2"}  # fmt: skip
READ_ONLY = ("Model", "Firmware", "Present", "Registered", "Hardware", "Realtime", "Moving", "Status",
             "Velocity_Trajectory", "Position_Trajectory", "Maximum", "Moving_Velocity", "DTs", "Velocity_Unit",
             "Hts", "Angular", "Default")  # fmt: skip
WRITABLE_BEGINNINGS = {"Moving_Threshold"}


class Checks:
    """Counts what holds."""

    def __init__(self) -> None:
        self.done, self.failed = 0, []

    def __call__(self, name: str, check: Callable[[], object]) -> None:
        """Make a check and count it."""
        self.done += 1
        try:
            answer = check()
        except Exception as error:  # noqa: BLE001  whatever LeRobot raises is an answer that was not as expected
            self.failed.append(f"{name}: {error!r}"[:160])
            return
        if answer is False:
            self.failed.append(name)


def is_writable(name: str) -> bool:
    """Whether an item may be written here."""
    return name in WRITABLE_BEGINNINGS or not (name in UNTOUCHED or name.startswith(READ_ONLY))


def writes_and_reads_back(bus: DynamixelMotorsBus | FeetechMotorsBus, item: str, motor: str) -> bool:
    """Write what an item holds, and a neighbour of it within its range; say whether both read back."""
    held = bus.read(item, motor, normalize=False)
    neighbour = held + 1 if item.startswith("Min_") else max(held - 1, 0) if held >= 0 else held
    for value in (held, neighbour):
        bus.write(item, motor, value, normalize=False)
        if bus.read(item, motor, normalize=False) != value:
            return False
    bus.write(item, motor, held, normalize=False)
    return True


def table_checks(bus: DynamixelMotorsBus | FeetechMotorsBus, check: Checks, model: str) -> None:
    """Read every item of LeRobot's table from one servo, write those that may be, and read all in a group."""
    for item in bus.model_ctrl_table[model]:
        check(f"read {item}", lambda item=item: bus.read(item, NAMES[0], normalize=False) is not None)
        check(f"group read {item}", lambda item=item: len(bus.sync_read(item, normalize=False)) == len(NAMES))
        if is_writable(item):
            check(f"write {item}", lambda item=item: writes_and_reads_back(bus, item, NAMES[0]))


def read_all(bus: DynamixelMotorsBus | FeetechMotorsBus, item: str) -> dict[str, int]:
    """Read an item of all servos in a group, as it is."""
    return bus.sync_read(item, normalize=False)


def use_checks(bus: DynamixelMotorsBus | FeetechMotorsBus, check: Checks, number: int) -> None:
    """What a robot does: ping, configure, calibrate, torque, goals one by one and in a group, a locked EEPROM."""
    check("broadcast ping", lambda: bus.broadcast_ping() == dict.fromkeys((1, 2, 3), number))
    for name in NAMES:
        check(f"ping {name}", lambda name=name: bus.ping(name) == number)
    check("configure", bus.configure_motors)
    check("return delay", lambda: set(read_all(bus, "Return_Delay_Time").values()) == {0})
    if isinstance(bus, DynamixelMotorsBus):  # as robots/koch_follower does: position mode ignores a large offset
        for name in NAMES:
            check(f"extended position {name}", lambda name=name: bus.write("Operating_Mode", name, 4))
    check("half turn homings", bus.set_half_turn_homings)
    check("half turn", lambda: max(abs(v - 2047) for v in read_all(bus, "Present_Position").values()) <= 2)
    check("read calibration", lambda: set(bus.read_calibration()) == set(NAMES))
    check("write calibration", lambda: bus.write_calibration(bus.read_calibration()))
    check("is calibrated", lambda: bus.is_calibrated)
    check("torque on", bus.enable_torque)
    check("torque reads back", lambda: set(read_all(bus, "Torque_Enable").values()) == {1})
    goals = {name: 2047 + 20 * i for i, name in enumerate(NAMES)}
    check("group write", lambda: bus.sync_write("Goal_Position", goals, normalize=False))
    check("goals read back", lambda: read_all(bus, "Goal_Position") == goals)
    check("torque off", bus.disable_torque)
    check("torque is off", lambda: set(read_all(bus, "Torque_Enable").values()) == {0})


def main() -> int:
    """Print the count and what differs."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("port")
    arguments.add_argument("model")
    options = arguments.parse_args()
    make = FeetechMotorsBus if options.model.startswith("sts") else DynamixelMotorsBus
    motors = {name: Motor(i, options.model, MotorNormMode.DEGREES) for i, name in enumerate(NAMES, 1)}
    bus, check = make(options.port, motors), Checks()
    # An emulated servo is a thread of a busy machine; the SDKs give a real one 34 to 50 ms.
    bus.port_handler.setPacketTimeout = lambda _: bus.port_handler.setPacketTimeoutMillis(TIMEOUT_MS)
    check("connect and handshake", bus.connect)
    table_checks(bus, check, options.model)
    use_checks(bus, check, bus.model_number_table[options.model])
    check("disconnect", bus.disconnect)
    print(f"{options.model}: {check.done - len(check.failed)} of {check.done} checks hold")
    for text in check.failed:
        print(f"  {text}")
    return 0 if not check.failed else 1


if __name__ == "__main__":
    sys.exit(main())
