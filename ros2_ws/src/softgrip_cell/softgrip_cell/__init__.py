# SPDX-License-Identifier: Apache-2.0
"""What the cell decides: products, profiles, finger records, swaps, grasps, schedule."""
