# SPDX-License-Identifier: Apache-2.0
"""The friction rig: a stage that pulls, a gauge that weighs, and the guided measurement between them."""
