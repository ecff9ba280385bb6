# SPDX-License-Identifier: Apache-2.0
"""Launch files, configuration and the shipped finger profiles; no logic."""
