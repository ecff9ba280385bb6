# SPDX-License-Identifier: Apache-2.0
"""The cell as a standard gripper: goals of control_msgs' gripper actions as orders to the tendons; no ROS."""
