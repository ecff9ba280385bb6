# SPDX-License-Identifier: Apache-2.0
"""What every softgrip node shares: parameter table, QoS presets, diagnostics, start and stop.

Node-level code: it imports rclpy, and only modules under a package's ``nodes/`` import it.
"""

from softgrip_nodekit.callback_errors import CallbackErrors, callback_errors
from softgrip_nodekit.cell_lock import claim_name
from softgrip_nodekit.cell_time import (
    CellFollower,
    cell_clock,
    duration_clock,
    duration_timer,
    join_cell_time,
    steady_timer,
)
from softgrip_nodekit.diagnostics import Diagnostics, Health
from softgrip_nodekit.errors import FatalError, StartupError, answer, startup_errors
from softgrip_nodekit.event_time import StampedInputs, input_stamp_ns, lateness_parameter
from softgrip_nodekit.executor import make_executor, with_message_info
from softgrip_nodekit.health import HealthMonitor, HealthWatch, Pings
from softgrip_nodekit.node import CellNode, HardwareNode
from softgrip_nodekit.node_io import (
    GoalClient,
    GoalHandle,
    GoalResult,
    NodeIo,
    PendingResult,
    RecordingIo,
    SentGoal,
    ServiceClient,
)
from softgrip_nodekit.parameters import Parameter, ParameterTable
from softgrip_nodekit.priority import REALTIME_PRIORITY, Rank, WhileBrief, claim_processor, realtime_parameter
from softgrip_nodekit.qos import LATCHED, RELIABLE, SENSOR
from softgrip_nodekit.run import run
from softgrip_nodekit.stamps import nanoseconds, seconds, to_time_message
from softgrip_nodekit.standstill import OrderGuard
from softgrip_nodekit.transforms import transform_message
from softgrip_nodekit.urgent import UrgentServer

__all__ = [
    "LATCHED",
    "REALTIME_PRIORITY",
    "RELIABLE",
    "SENSOR",
    "CallbackErrors",
    "CellFollower",
    "CellNode",
    "Diagnostics",
    "FatalError",
    "GoalClient",
    "GoalHandle",
    "GoalResult",
    "HardwareNode",
    "Health",
    "HealthMonitor",
    "HealthWatch",
    "NodeIo",
    "OrderGuard",
    "Parameter",
    "ParameterTable",
    "PendingResult",
    "Pings",
    "Rank",
    "RecordingIo",
    "SentGoal",
    "ServiceClient",
    "StampedInputs",
    "StartupError",
    "UrgentServer",
    "WhileBrief",
    "answer",
    "callback_errors",
    "cell_clock",
    "claim_name",
    "claim_processor",
    "duration_clock",
    "duration_timer",
    "input_stamp_ns",
    "join_cell_time",
    "lateness_parameter",
    "make_executor",
    "nanoseconds",
    "realtime_parameter",
    "run",
    "seconds",
    "startup_errors",
    "steady_timer",
    "to_time_message",
    "transform_message",
    "with_message_info",
]
