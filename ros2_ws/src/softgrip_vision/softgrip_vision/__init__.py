# SPDX-License-Identifier: Apache-2.0
"""Camera and marker tracker: the cell's ground truth for finger joints and tip."""
