# SPDX-License-Identifier: Apache-2.0
"""The operator's panel: page model without ROS or HTTP (`model`), who may (`access`), pages (`web`), node (`nodes`)."""
