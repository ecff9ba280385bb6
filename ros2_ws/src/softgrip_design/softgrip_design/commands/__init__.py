# SPDX-License-Identifier: Apache-2.0
"""Commands that `ros2 run softgrip_design` finds."""
