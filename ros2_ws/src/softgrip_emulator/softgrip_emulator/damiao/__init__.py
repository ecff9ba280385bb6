# SPDX-License-Identifier: Apache-2.0
"""Emulated Damiao joint motors on CAN behind a serial adapter that speaks SLCAN."""
