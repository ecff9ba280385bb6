# SPDX-License-Identifier: Apache-2.0
"""From servos as they come to a chain that is named, verified, turned the right way, and tensioned."""
