# SPDX-License-Identifier: Apache-2.0
"""What a person does at the cell when it asks: sets the rig, seats fingers, takes others when some are refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final

from std_srvs.srv import Trigger

from softgrip_cell.nodes.controller_client import CellController
from softgrip_cell.swap.check import CheckSettings
from softgrip_cell.swap.sequence import HANDS_OUT_TEXT
from softgrip_demo.errors import ShiftError
from softgrip_demo.nodes.hands import Hands, seat
from softgrip_demo.nodes.link import CellLink, calibrate
from softgrip_demo.products import serials_of
from softgrip_interfaces.action import CalibrateFriction, MoveTendon

#: The same fingers are seated so often before they are laid aside: a cable can be hooked in badly.
SEATINGS: Final = 2
TRIES: Final = 4

#: Says that a swap was refused for a fault of the drives, not of the fingers.
DRIVER_FAULT: Final = "the driver has a fault"
HOMING_TIMEOUT: Final = 30.0  # [s]
CLOSING_TENSION: Final = CheckSettings().tension_limit_n  # [N] at which a finger has closed as far as it goes


class CellOperator:
    """Calibrates the rig, swaps fingers and moves them, on emulated hardware.

    Args:
        link: calls services and actions.
        hands: move things on the emulated hardware.
        cell: the cell's client.
        slots: of the gripper.
    """

    def __init__(self, link: CellLink, hands: Hands, cell: CellController, slots: Sequence[str]) -> None:
        self._link = link
        self._hands = hands
        self._cell = cell
        self._slots = slots
        self._log = link.node.get_logger()
        self._copies: Counter[str] = Counter()

    def calibrate(self, cable_radius: float, surface_radius: float) -> CalibrateFriction.Result:
        """Nine points (Table 3.3), with angle and weight as the rig asks for them.

        Raises:
            ShiftError: the rig does not answer or fails.
        """

        def set_up(feedback: CalibrateFriction.Feedback) -> None:
            self._log.info(f"rig: {feedback.instruction}")
            self._hands.set_rig(feedback.angle, feedback.load)

        goal = CalibrateFriction.Goal(
            plan="9",
            law="matte",
            cable="PE braid 0.25 mm",
            surface="TPU, printed along the layers",
            cable_radius=cable_radius,
            surface_radius=surface_radius,
            activate=True,
        )
        return calibrate(self._link, goal, set_up, 120.0)

    def swap(self, finger_set: str) -> None:
        """Order a set to be mounted; fingers that the check refuses are laid aside and the next ones taken.

        Raises:
            ShiftError: no fingers of the set passed; says why each did not.
        """
        reasons: list[str] = []
        seatings = 0
        while len(reasons) < TRIES:
            try:
                serials = serials_of(finger_set, self._slots, self._copies[finger_set])
            except ShiftError as error:
                reasons.append(str(error))
                break
            result = self._cell.swap(finger_set, self._seat(finger_set, serials), serials)
            if result.outcome == result.SUCCEEDED:
                self._log.info(f"swap to {finger_set}: {result.reason}")
                return
            self._log.warning(f"swap to {finger_set}: {result.reason}")
            reasons.append(f"{serials[0]} ...: {result.reason}")
            if HANDS_OUT_TEXT in result.reason:
                self._cell.hands_out()  # the hands of the emulated cell are out after every call
            if DRIVER_FAULT in result.reason:
                self._home()
                continue
            seatings += 1
            if seatings == SEATINGS or "refused" in result.reason:
                self._copies[finger_set] += 1
                seatings = 0
        raise ShiftError(f"no {finger_set} fingers passed: {'; '.join(reasons)}")

    def _home(self) -> None:
        """Home again; it clears the faults that a person at the cell can resolve."""
        try:
            self._link.call(Trigger, "tendon/home", Trigger.Request(), timeout=HOMING_TIMEOUT)
        except ShiftError as error:
            self._log.warning(str(error))

    def move(self, pulled_length_m: float, speed: float) -> None:
        """Close or open all fingers to a pulled length [m] at a speed [m/s].

        The order carries no lease: between two swaps nobody owns the tendons, and a single movement ends by itself.

        Raises:
            ShiftError: they did not get there.
        """
        goal = MoveTendon.Goal(
            mode=MoveTendon.Goal.LENGTH, targets=[pulled_length_m], speed=speed, tension_limit=CLOSING_TENSION
        )
        result = self._link.act(MoveTendon, "tendon/move", goal, timeout=30.0)
        if result.outcome not in {result.REACHED, result.TENSION_LIMIT}:
            raise ShiftError(f"tendon/move to {1000 * pulled_length_m:g} mm ended otherwise: {result.reason}")

    def _seat(self, finger_set: str, serials: Sequence[str]) -> Callable[[str, str], Sequence[str]]:
        """Return what the hands do at each step of a swap."""

        def confirm(step: str, instruction: str) -> Sequence[str]:
            self._log.info(f"swap: {instruction}")
            return seat(self._hands, step, self._slots, serials, finger_set)

        return confirm
