# SPDX-License-Identifier: Apache-2.0
"""What a user types: `ros2 run softgrip_vision calibrate_camera` and `track`. None of it needs ROS."""
