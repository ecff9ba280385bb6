# SPDX-License-Identifier: Apache-2.0
"""What a latched stop or a lock means for the drives, by the gripper's policies."""

from __future__ import annotations

from softgrip_driver.tendon.gripper import Block, Policies, StopPolicy
from softgrip_driver.tendon.safety import Safety
from softgrip_driver.tendon.safety_store import SafetyRecord, StopCause


def block_of(safety: Safety, policies: Policies) -> Block | None:
    """Return why nothing may move now and whether torque goes off; None = it may."""
    record = safety.record
    if not record.is_blocked:
        return None
    lets_go = record.is_locked or _stop_policy(record, policies) is StopPolicy.LET_GO
    return Block(safety.refusal, record.is_stopped, lets_go, cause=record.stop_reason)


def keeps_torque(record: SafetyRecord, policies: Policies) -> bool:
    """Return whether drives that are found holding at the start may go on doing so."""
    return not record.is_locked and record.is_stopped and _stop_policy(record, policies) is StopPolicy.HOLD


def _stop_policy(record: SafetyRecord, policies: Policies) -> StopPolicy:
    is_by_driver = record.cause in {StopCause.UNCLEAN_END, StopCause.STANDSTILL}
    return policies.unclean_end if is_by_driver else policies.estop
