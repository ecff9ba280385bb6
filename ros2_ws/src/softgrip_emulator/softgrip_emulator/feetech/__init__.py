# SPDX-License-Identifier: Apache-2.0
"""Emulated Feetech STS servos: memory table, packets, firmware and bus."""
