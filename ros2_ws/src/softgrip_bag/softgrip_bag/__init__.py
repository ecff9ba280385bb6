# SPDX-License-Identifier: Apache-2.0
"""Bags: recorder, replayer, regression of recorded traffic, report."""
