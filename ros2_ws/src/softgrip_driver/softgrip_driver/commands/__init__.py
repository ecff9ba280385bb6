# SPDX-License-Identifier: Apache-2.0
"""Command line tools for the bench: scan, setup, selftest, calibrate_cell, calibrate_tension, stage."""
