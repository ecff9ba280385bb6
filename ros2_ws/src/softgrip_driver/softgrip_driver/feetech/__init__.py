# SPDX-License-Identifier: Apache-2.0
"""Feetech STS servos: memory table as data, packets and bus of the maker's SCS protocol, the tendon backend."""
