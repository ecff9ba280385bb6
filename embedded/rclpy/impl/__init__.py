# SPDX-License-Identifier: Apache-2.0
"""Kept for the import paths of rclpy."""
