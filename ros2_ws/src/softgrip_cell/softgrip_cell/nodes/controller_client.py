# SPDX-License-Identifier: Apache-2.0
"""A cell controller's client: everything a line needs of the cell, over services and actions only.

Usage::

    controller = CellController(node)
    choice = controller.select("egg")
    if choice.swap_needed:
        controller.swap(choice.finger_set, confirm=ask_the_operator)
    result = controller.grasp("egg")
    controller.release()

Calls block until the answer is there; meanwhile the node is spun.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol, TypeVar

import rclpy
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from std_srvs.srv import Trigger

from softgrip_cell.errors import CellError, RefusedError
from softgrip_cell.grasp.values import GraspPhase
from softgrip_cell.nodes.convert import GRASP_PHASES, swap_step
from softgrip_cell.swap.sequence import HANDS_OUT, HANDS_OUT_TEXT
from softgrip_interfaces.action import Grasp, SwapFingers
from softgrip_interfaces.srv import ConfirmStep, PlanMix, SelectProduct
from softgrip_nodekit.errors import SuccessResponseT

if TYPE_CHECKING:
    from rclpy.client import Client
    from rclpy.task import Future
    from rclpy.type_support import FeedbackMessage

T = TypeVar("T")
Goal = TypeVar("Goal")
Result = TypeVar("Result")
Feedback = TypeVar("Feedback")
Request = TypeVar("Request")

#: What the operator answers to a step: the serials read on the fingers where the step asks for them, else nothing.
Confirm = Callable[[str, str], Sequence[str]]


class Wait(Protocol):
    """Waits until a future is done and returns its result."""

    def __call__(self, future: Future[T], timeout_s: float, expected: str, /) -> T:
        """Wait; the error says that nothing of what was expected came in time."""


#: Names of the outcomes of cell/grasp, by number.
GRASP_OUTCOMES = {
    Grasp.Result.GRIPPED: "GRIPPED",
    Grasp.Result.EMPTY: "EMPTY",
    Grasp.Result.SLIPPED: "SLIPPED",
    Grasp.Result.TENDON_FAULT: "TENDON_FAULT",
    Grasp.Result.ABORTED: "ABORTED",
}
_PHASES = {number: phase for phase, number in GRASP_PHASES.items()}


class CellTimeout(CellError):  # noqa: N818  reads as what it is
    """The cell did not answer in time."""


def _nothing() -> object:
    """Cancel nothing."""


class CellController:
    """Calls the cell.

    Args:
        node: owner of the clients; it has to be in an executor that ``wait`` spins, or in none.
        wait: how to wait for a future; by default the node is spun.
    """

    def __init__(self, node: Node, wait: Wait | None = None) -> None:
        self._node = node
        self._wait = wait or self._spin
        self._select: Client[SelectProduct.Request, SelectProduct.Response] = node.create_client(
            SelectProduct, "cell/select_product"
        )
        self._plan: Client[PlanMix.Request, PlanMix.Response] = node.create_client(PlanMix, "cell/plan_mix")
        self._confirm = node.create_client(ConfirmStep, "cell/confirm_step")
        self._release = node.create_client(Trigger, "tendon/release")
        self._swap: ActionClient[SwapFingers.Goal, SwapFingers.Result, SwapFingers.Feedback] = ActionClient(
            node, SwapFingers, "cell/swap"
        )
        self._grasp: ActionClient[Grasp.Goal, Grasp.Result, Grasp.Feedback] = ActionClient(node, Grasp, "cell/grasp")
        self._token = ""  # of the last swap
        self._cancel: Callable[[], object] = _nothing  # what the action that goes on is cancelled with

    def select(self, product: str) -> SelectProduct.Response:
        """Ask how a product is to be grasped.

        Raises:
            RefusedError: the cell does not know or hold it.
        """
        return self._call(self._select, SelectProduct.Request(product=product))

    def plan(self, products: Sequence[str], quantities: Sequence[int], *, keep_order: bool = False) -> PlanMix.Response:
        """Ask for the sequence with as few swaps as there can be.

        Raises:
            RefusedError: an order cannot be served.
        """
        request = PlanMix.Request(products=list(products), quantities=list(quantities), keep_order=keep_order)
        return self._call(self._plan, request)

    def swap(
        self, finger_set: str, confirm: Confirm, serials: Sequence[str] = (), timeout_s: float = 330.0
    ) -> SwapFingers.Result:
        """Order a swap of fingers, and their check.

        Args:
            finger_set: "power", "pinch" or "hook".
            confirm: called with (step, instruction) for every step that a person does, once it is done; returns the
                serials read on the fingers (slot order) where the instruction asks for them.
            serials: fingers wanted, slot order; empty for any usable ones.
            timeout_s: longest wait for the whole swap [s].

        Returns:
            what came of it; look at its outcome.

        Raises:
            RefusedError: by the cell; or of ``confirm``: the swap is cancelled, and what unlocks the drives is said.
        """
        refused: list[RefusedError] = []

        def on_feedback(message: FeedbackMessage[SwapFingers.Feedback]) -> None:
            feedback = message.feedback
            self._token = feedback.token
            if feedback.confirmation and not refused:
                try:
                    given = list(confirm(swap_step(feedback).value, feedback.instruction))
                except RefusedError as error:
                    refused.append(error)
                    self._cancel()
                    return
                request = ConfirmStep.Request(step=feedback.step, token=feedback.token, serials=given)
                answer = self._confirm.call_async(request)
                answer.add_done_callback(self._log_refusal)

        goal = SwapFingers.Goal(finger_set=finger_set, serials=list(serials))
        result = self._act(self._swap, "cell/swap", goal, on_feedback, timeout_s, lambda: bool(refused))
        if refused:
            raise RefusedError(f"{refused[0]}; {result.reason}; the token: {self._token}") from refused[0]
        return result

    @property
    def may_unlock(self) -> bool:
        """Whether a swap gave this client its token, with which `hands_out` unlocks the drives."""
        return bool(self._token)

    def hands_out(self) -> None:
        """Confirm that a person's hands are out of the cell after the last swap ended early: the drives are unlocked.

        Raises:
            RefusedError: no swap of this client left the drives locked.
        """
        self._call(self._confirm, ConfirmStep.Request(step=ConfirmStep.Request.HANDS_OUT, token=self._token))

    def grasp(
        self,
        product: str,
        *,
        confirm_lift: bool = True,
        trial: bool = False,
        on_phase: Callable[[GraspPhase], None] | None = None,
        timeout_s: float = 60.0,
    ) -> Grasp.Result:
        """Order a grasp.

        Args:
            product: id.
            confirm_lift: lift when ``on_phase`` says LIFT; the cell then watches the hold before it says GRIPPED.
            trial: grasp even with fingers that are known to fail on the product.
            on_phase: called with each phase once; GraspPhase.LIFT == "lift".
            timeout_s: longest wait [s].

        Returns:
            what came of it; look at its outcome (names in GRASP_OUTCOMES).
        """
        given: list[GraspPhase] = []

        def on_feedback(message: FeedbackMessage[Grasp.Feedback]) -> None:
            phase = _PHASES.get(message.feedback.phase, GraspPhase.DONE)
            if on_phase is not None and phase not in given:
                given.append(phase)
                on_phase(phase)

        goal = Grasp.Goal(product=product, confirm_lift=confirm_lift, trial=trial)
        return self._act(self._grasp, "cell/grasp", goal, on_feedback, timeout_s)

    def release(self, timeout_s: float = 10.0) -> None:
        """Let go of what is held: the tendons go slack, slowly.

        Raises:
            RefusedError: the driver will not.
        """
        self._call(self._release, Trigger.Request(), timeout_s)

    def _log_refusal(self, future: Future[ConfirmStep.Response]) -> None:
        response = future.result()
        if response is not None and not response.success:
            self._node.get_logger().error(f"cell/confirm_step refused: {response.message}")

    def _call(
        self, client: Client[Request, SuccessResponseT], request: Request, timeout_s: float = 10.0
    ) -> SuccessResponseT:
        if not client.wait_for_service(timeout_sec=timeout_s):
            raise CellTimeout(f"expected service {client.srv_name} within {timeout_s:g} s, found none; is the cell up?")
        response = self._wait(client.call_async(request), timeout_s, f"an answer of {client.srv_name}")
        if not response.success:
            raise RefusedError(f"{client.srv_name}: {response.message}")
        return response

    def _act(
        self,
        client: ActionClient[Goal, Result, Feedback],
        name: str,
        goal: Goal,
        on_feedback: Callable[[FeedbackMessage[Feedback]], None],
        timeout_s: float,
        given_up: Callable[[], bool] = lambda: False,
    ) -> Result:
        self._cancel = _nothing
        if not client.wait_for_server(timeout_sec=10.0):
            raise CellTimeout(f"expected action {name} within 10 s, found none; is the cell up?")
        handle = self._wait(client.send_goal_async(goal, feedback_callback=on_feedback), 10.0, f"{name} to take a goal")
        if not handle.accepted:
            raise RefusedError(f"{name} rejected the goal")
        self._cancel = handle.cancel_goal_async
        if given_up():  # by feedback that was here before the answer
            self._cancel()
        try:
            answer = self._wait(handle.get_result_async(), timeout_s, f"the end of {name}")
        except CellTimeout:
            self._cancel()
            raise
        if answer.status not in (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED):
            raise CellTimeout(f"{name} ended with status {answer.status}; the manager may have gone away")
        return answer.result

    def _spin(self, future: Future[T], timeout_s: float, expected: str, /) -> T:
        rclpy.spin_until_future_complete(self._node, future, timeout_sec=timeout_s)
        if not future.done():
            raise CellTimeout(f"expected {expected} within {timeout_s:g} s, found nothing")
        return future.result()


def ask(step: str, instruction: str) -> Sequence[str]:
    """Ask the person at the terminal.

    Raises:
        RefusedError: nobody is there any more.
    """
    try:
        answer = input(f"{instruction}\n[{step}] press Enter when done, or type the serials: ")
    except (EOFError, KeyboardInterrupt) as error:
        raise RefusedError(f"expected Enter or serials at step '{step}', found the end of the input") from error
    return answer.replace(",", " ").split()


def main(args: Sequence[str] | None = None) -> int:
    """Grasp products one after the other, with swaps where they are needed."""
    parser = argparse.ArgumentParser(
        prog="cell_controller",
        description="Plan a mix, swap fingers where needed and grasp every product, asking you for the swaps.",
        epilog="example: ros2 run softgrip_cell cell_controller egg=2 grape=1",
    )
    parser.add_argument("orders", nargs="+", metavar="PRODUCT[=QUANTITY]", help="what to pick, e.g. egg=2 grape")
    parser.add_argument("--keep-order", action="store_true", help="do not reorder, only choose finger sets")
    parser.add_argument("--no-lift", action="store_true", help="take the first grip for good, without the lift window")
    options = parser.parse_args(remove_ros_args(sys.argv if args is None else ["cell_controller", *args])[1:])
    orders = [order.partition("=") for order in options.orders]
    rclpy.init(args=list(args) if args is not None else None)
    node = Node("cell_controller")
    controller = CellController(node)
    try:
        products = [product for product, _, _ in orders]
        plan = controller.plan(
            products, [int(quantity or 1) for _, _, quantity in orders], keep_order=options.keep_order
        )
        for step in plan.steps:
            for _ in range(int(orders[step.order][2] or 1)):
                if controller.select(step.product).swap_needed:
                    swapped = controller.swap(step.finger_set, ask)
                    if swapped.outcome != swapped.SUCCEEDED:
                        if HANDS_OUT_TEXT in swapped.reason and controller.may_unlock:
                            ask(HANDS_OUT, "Take your hands out of the cell.")
                            controller.hands_out()
                        raise RefusedError(f"swap to '{step.finger_set}': {swapped.reason}")
                result = controller.grasp(step.product, confirm_lift=not options.no_lift)
                print(f"{step.product}: {GRASP_OUTCOMES[result.outcome]}: {result.reason}")  # noqa: T201  its output
                controller.release()
    except (CellError, ValueError) as error:
        print(f"[cell_controller] {error}", file=sys.stderr)  # noqa: T201  its output
        return 1
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
