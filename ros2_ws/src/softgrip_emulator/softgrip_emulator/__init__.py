# SPDX-License-Identifier: Apache-2.0
"""The emulated cell: the same wire protocols, driven by one simulated plant, with faults on demand."""
