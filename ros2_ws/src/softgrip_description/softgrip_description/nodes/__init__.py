# SPDX-License-Identifier: Apache-2.0
"""Nodes of softgrip_description."""
