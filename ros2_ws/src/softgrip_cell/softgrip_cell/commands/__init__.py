# SPDX-License-Identifier: Apache-2.0
"""Command lines of softgrip_cell that need no ROS."""
