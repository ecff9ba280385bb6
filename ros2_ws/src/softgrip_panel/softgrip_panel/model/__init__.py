# SPDX-License-Identifier: Apache-2.0
"""What the pages show and what a click means, without ROS and without HTTP."""
