# SPDX-License-Identifier: Apache-2.0
"""The chain of a cell file as the driver's backend, with the limits that its servos ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace

from softgrip_description.cell_file import ChainServo, ServoChain
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.gripper import GripperController, Policies
from softgrip_driver.tendon.limits import LIMIT_PARAMETERS, TendonLimits
from softgrip_driver.tendon.loop import BusLoop
from softgrip_driver.tendon.needs import SHIPPED_LOOP_RATE
from softgrip_driver.tendon.safety_store import check_port_is_free_to_move
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_driver.wizard.drive_setup import ChainRow, DriveSetup, SetupBackend, SetupBus, SetupModel, drive_setup
from softgrip_time import Clock

#: [1/s], [m] where the cell file does not say
BAUD, SPOOL_RADIUS_M = 1_000_000, 0.010
#: [s] of silence that is no fault here: somebody stands beside, pulls are small
NO_REPLY_S = 0.3


def setup_of(chain: ServoChain) -> DriveSetup:
    """Return the set-up of a chain's drives; raises ConfigurationError where there is none."""
    return drive_setup(chain.drive)


def model_of(chain: ServoChain, servo: ChainServo) -> SetupModel:
    """Return the model of a servo; raises ConfigurationError for one that is not known."""
    models = setup_of(chain).models
    if servo.model not in models:
        raise ConfigurationError(f"{servo.tendon}: expected a model of {sorted(models)}, found {servo.model}")
    return models[servo.model]


def spool_of(servo: ChainServo) -> Spool:
    """Return a servo's spool; a direction that is not known is taken for 1."""
    return Spool(servo.spool_radius_m or SPOOL_RADIUS_M, servo.direction or 1)


def chain_parameters(chain: ServoChain) -> dict[str, float | int]:
    """Return the parameters of tendon_driver that the servos of a chain ask for beyond what is shipped."""
    return setup_of(chain).required_parameters([(model_of(chain, one), spool_of(one).radius) for one in chain.chain])


def torque_of_data_sheet(chain: ServoChain, servo: ChainServo) -> TorqueModel:
    """Return what a servo's data sheet says of the tension that its current makes."""
    return setup_of(chain).torque_of_data_sheet(model_of(chain, servo), spool_of(servo))


def is_calibrated(servo: ChainServo) -> bool:
    """Return whether `calibrate_tension` has been run for a servo."""
    return (servo.torque.torque_per_ampere_nm_a or 0.0) > 0.0


def torque_of(chain: ServoChain, servo: ChainServo) -> TorqueModel:
    """Return the torque model that the driver has of a servo: the calibrated one, else the data sheet's."""
    given, sheet = servo.torque, torque_of_data_sheet(chain, servo)
    share = sheet.relative_stddev if given.tension_stddev_share is None else given.tension_stddev_share
    if not is_calibrated(servo):
        return replace(
            sheet, friction_current=given.friction_current_a or sheet.friction_current, relative_stddev=share
        )
    return TorqueModel(
        given.torque_per_ampere_nm_a or 0.0,
        given.friction_current_a or 0.0,
        share,
        "calibrate_tension",
        given.friction_slope_a_s_m or 0.0,
        given.gear_load_share or 0.0,
        given.quick_stddev_n_s2_m2 or 0.0,
    )


def homing_tension(chain: ServoChain, given: Mapping[str, float | int]) -> float:
    """Return the tension [N] that counts as taut: the file's, else what the servos ask for, else the shipped one."""
    name = LIMIT_PARAMETERS["homing_tension"]
    return float(given.get(name, chain_parameters(chain).get(name, TendonLimits().homing_tension)))


def chain_rate(chain: ServoChain) -> float:
    """Return the rate [Hz] of the control loop that a chain asks for."""
    return float(chain_parameters(chain).get("loop_rate", SHIPPED_LOOP_RATE))


@contextmanager
def open_bus(chain: ServoChain, reply_margin_s: float, clock: Clock | None = None) -> Iterator[SetupBus]:
    """Give the open bus of a chain, and close it; raises DriverError."""
    bus = setup_of(chain).make_bus(chain.port, chain.baud or BAUD, reply_margin_s, clock)
    bus.open()
    try:
        with bus.clock.stepping():
            yield bus
    finally:
        bus.close()


def chain_backend(
    chain: ServoChain,
    servos: Sequence[ChainServo],
    reply_margin_s: float,
    report: Callable[[str], object],
    clock: Clock | None = None,
) -> SetupBackend:
    """Return the backend of some servos of a chain, not connected; a direction that is not known is taken for 1.

    Raises:
        SafetyStoreError: an emergency stop or a lock keeps the drives of the chain's port from moving.
    """
    check_port_is_free_to_move(chain.port)
    setup, parameters = setup_of(chain), chain_parameters(chain)
    limits = _limits(parameters)
    rows = [ChainRow(one.tendon, one.servo_id, model_of(chain, one), spool_of(one), limits) for one in servos]
    bus = setup.make_bus(chain.port, chain.baud or BAUD, reply_margin_s, clock)
    return setup.make_backend(bus, rows, parameters, report)


def chain_controller(chain: ServoChain, servos: Sequence[ChainServo]) -> GripperController:
    """Return a controller of some tendons of a chain that nothing blocks."""
    limits = _limits(chain_parameters(chain))
    return GripperController({one.tendon: limits for one in servos}, Policies(), None, 1.0 / chain_rate(chain))


def make_loop(backend: SetupBackend, controller: GripperController, rate: float) -> BusLoop:
    """Return the driver's loop, in the time of its bus."""
    return BusLoop(backend, controller, rate, clock=backend.bus.clock)


def _limits(parameters: dict[str, float | int]) -> TendonLimits:
    by_parameter = {parameter: name for name, parameter in LIMIT_PARAMETERS.items()}
    given = {by_parameter[name]: float(value) for name, value in parameters.items() if name in by_parameter}
    return TendonLimits(**({"no_reply": NO_REPLY_S} | given))
