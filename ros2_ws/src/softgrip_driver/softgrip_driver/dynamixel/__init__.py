# SPDX-License-Identifier: Apache-2.0
"""Dynamixel X servos on Protocol 2.0: control tables as data, the bus around dynamixel-sdk, the tendon backend."""
