# SPDX-License-Identifier: Apache-2.0
"""What tests and benchmarks of several packages share; no product code imports it."""
