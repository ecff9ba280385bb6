# SPDX-License-Identifier: Apache-2.0
"""Devices of the cell: tendon servos, linear stage, test stand, force gauge, load-cell amplifiers."""
