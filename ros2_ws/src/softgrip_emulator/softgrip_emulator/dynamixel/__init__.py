# SPDX-License-Identifier: Apache-2.0
"""The servo's side of Dynamixel Protocol 2.0: packets, control tables, firmware behaviour, the chain on its bus."""
