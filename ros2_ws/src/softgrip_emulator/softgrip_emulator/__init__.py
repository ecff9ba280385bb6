# SPDX-License-Identifier: Apache-2.0
"""The cell that isn't there: the same wire protocols, driven by one simulated plant, with faults on demand."""
