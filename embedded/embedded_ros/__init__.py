# SPDX-License-Identifier: Apache-2.0
"""What stands behind ``rclpy`` and ``ros2`` on machines without ROS 2: types, wire, names, launch, commands."""
