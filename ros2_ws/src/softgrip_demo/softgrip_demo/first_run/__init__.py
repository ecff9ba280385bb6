# SPDX-License-Identifier: Apache-2.0
"""The first run of a cell: a checklist from its ports to a grasp, every figure beside its bound, on one signed page."""
