# SPDX-License-Identifier: Apache-2.0
"""Damiao joint motors on CAN, through a serial adapter that speaks SLCAN: frames, bus, the tendon backend."""
