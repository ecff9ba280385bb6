# SPDX-License-Identifier: Apache-2.0
"""The pages: NiceGUI and Starlette; nothing here knows ROS."""
