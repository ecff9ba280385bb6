# SPDX-License-Identifier: Apache-2.0
"""Swapping finger sets: the guided procedure and the check by an empty closing. Pure."""
