# SPDX-License-Identifier: Apache-2.0
"""Time that code is given instead of asking the computer for it: `WallClock`, or `SimulatedClock` of an emulated cell.

Pure code: it knows no ROS.
"""

from softgrip_time.clock import Clock, WallClock
from softgrip_time.follower import Follower
from softgrip_time.simulated import SimulatedClock

__all__ = ["Clock", "Follower", "SimulatedClock", "WallClock"]
