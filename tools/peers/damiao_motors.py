# SPDX-License-Identifier: Apache-2.0
r"""damiao-motor's controller against emulated motors: how many checks hold, and which do not.

In an environment of its own, through python-can's serial CAN adapter:

    python3 -m venv /tmp/damiao && /tmp/damiao/bin/pip install damiao-motor==1.0.6 python-can==4.6.1 pyserial==3.5
    python tools/peers/serve.py /tmp/motors DM-J4310-2EC --count 2 &
    /tmp/damiao/bin/python tools/peers/damiao_motors.py /tmp/motors

Frames, registers, names of states and units are damiao-motor's; what is expected of a motion is its documents'.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

from checks import Checks
from damiao_motor import DaMiaoController
from damiao_motor.core.motor import REGISTER_TABLE, DaMiaoMotor

#: of DM-J4310-2EC: Seeed Studio's table of specifications and the maker's manual
RATED = {"PMAX": 12.5, "VMAX": 30.0, "TMAX": 10.0, "NPP": 14, "Gr": 10.0, "Rs": 0.65}
#: registers that the emulated motor has; the others are calibration, versions and loops that it does without
NUMBERS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 14, 16, 17, 18, 19, 20, 21, 22, 23, 25, 26, 27, 28, 29, 35, 59, 60, 80, 81)
#: in the order of their numbers, from 1
MODES = ("MIT", "POS_VEL", "VEL", "FORCE_POS")
MOTION_S = 1.5
PERIOD_S = 0.01


def number_of(name: str) -> int:
    """Return a register's number by damiao-motor's name."""
    return next(rid for rid, info in REGISTER_TABLE.items() if info.variable == name)


def read(motor: DaMiaoMotor, number: int) -> float:
    """Return a register's value now: damiao-motor would return what it read before."""
    motor.registers.pop(number, None)
    return motor.get_register(number, timeout=0.5)


def keep(order: Callable[[], None], seconds: float) -> None:
    """Repeat an order, as a control loop does."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        order()
        time.sleep(PERIOD_S)


def set_mode(motor: DaMiaoMotor, mode: str) -> None:
    """Set the control mode, with what a motor is set to by damiao-motor."""
    motor.disable()
    motor.set_control_mode(MODES.index(mode) + 1)
    time.sleep(0.05)
    motor.set_zero_position()
    motor.enable()
    time.sleep(0.05)


def read_registers(check: Checks, motor: DaMiaoMotor) -> None:
    """Every register is answered; the ratings are those of the data sheets."""
    for number in NUMBERS:
        name = REGISTER_TABLE[number].variable
        try:
            value = read(motor, number)
        except TimeoutError as error:
            check(f"read {name}", holds=False, found=error)
            continue
        expected = RATED.get(name)
        check(f"read {name}", holds=expected is None or abs(value - expected) < 1e-3 * abs(expected), found=value)


def write_registers(check: Checks, motor: DaMiaoMotor) -> None:
    """What is written reads back; what is read-only damiao-motor itself refuses."""
    for name, value in (("TIMEOUT", 4000), ("KP_APR", 60.0), ("OT_Value", 95.0), ("ACC", 12.0)):
        before = read(motor, number_of(name))
        motor.write_register(number_of(name), value)
        time.sleep(0.02)
        found = read(motor, number_of(name))
        check(f"write {name}", holds=abs(found - value) < 1e-5 * value, found=found)
        motor.write_register(number_of(name), before)


def move(check: Checks, motor: DaMiaoMotor) -> None:
    """The four modes."""
    set_mode(motor, "MIT")
    keep(lambda: motor.send_cmd_mit(1.0, 0.0, 20.0, 1.0, 0.0), MOTION_S)
    check("MIT: to 1 rad", holds=abs(motor.get_states()["pos"] - 1.0) < 0.02, found=motor.get_states())
    set_mode(motor, "POS_VEL")
    began = time.monotonic()
    keep(lambda: motor.send_cmd_pos_vel(1.0, 2.0), 0.25)
    check("POS_VEL: at 2 rad/s", holds=abs(motor.get_states()["vel"] - 2.0) < 0.05, found=motor.get_states())
    keep(lambda: motor.send_cmd_pos_vel(1.0, 2.0), MOTION_S - (time.monotonic() - began))
    check("POS_VEL: to 1 rad", holds=abs(motor.get_states()["pos"] - 1.0) < 0.01, found=motor.get_states())
    for speed in (5.0, -5.0):
        set_mode(motor, "VEL")
        keep(lambda asked=speed: motor.send_cmd_vel(asked), MOTION_S)
        check(f"VEL: {speed:g} rad/s", holds=abs(motor.get_states()["vel"] - speed) < 0.05, found=motor.get_states())
    set_mode(motor, "FORCE_POS")
    keep(lambda: motor.send_cmd_force_pos(-1.0, 3.0, 0.2), MOTION_S)
    check("FORCE_POS: to -1 rad", holds=abs(motor.get_states()["pos"] + 1.0) < 0.01, found=motor.get_states())


def observe_states(check: Checks, motor: DaMiaoMotor, other: DaMiaoMotor) -> None:
    """States by damiao-motor's names, the silence that ends the torque, the neighbour that nothing was said to."""
    set_mode(motor, "MIT")
    keep(motor.send_cmd_mit, 0.1)
    check("enabled", holds=motor.get_states()["status"] == "ENABLED", found=motor.get_states())
    motor.set_can_timeout(100)
    time.sleep(0.4)
    motor.request_motor_feedback()
    time.sleep(0.1)
    check("lost communication", holds=motor.get_states()["status"] == "LOST_COMM", found=motor.get_states())
    motor.set_can_timeout(0)
    motor.clear_error()
    time.sleep(0.1)
    check("error cleared", holds=motor.get_states()["status"] == "DISABLED", found=motor.get_states())
    motor.enable()
    motor.disable()
    time.sleep(0.1)
    check("disabled", holds=motor.get_states()["status"] == "DISABLED", found=motor.get_states())
    motor.set_zero_position()
    motor.request_motor_feedback()
    time.sleep(0.1)
    check("zero set", holds=abs(motor.get_states()["pos"]) < 0.001, found=motor.get_states())
    other.request_motor_feedback()
    time.sleep(0.1)
    found = other.get_states()
    check("the other stands", holds=found["status"] == "DISABLED" and abs(found["pos"]) < 0.001, found=found)
    check("temperatures", holds=15.0 < found["t_mos"] < 60.0 and 15.0 < found["t_rotor"] < 60.0, found=found)


def main() -> None:
    """Check and report."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("port", help="where serve.py serves two motors")
    options = arguments.parse_args()
    controller = DaMiaoController(options.port, "slcan")
    motors = [controller.add_motor(number, 0x10 + number, "4310") for number in (1, 2)]
    check = Checks()
    try:
        read_registers(check, motors[0])
        write_registers(check, motors[0])
        move(check, motors[0])
        observe_states(check, *motors)
    finally:
        controller.shutdown()
    sys.exit(check.report("damiao-motor 1.0.6"))


if __name__ == "__main__":
    main()
