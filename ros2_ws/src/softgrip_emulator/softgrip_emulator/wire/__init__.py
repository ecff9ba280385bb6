# SPDX-License-Identifier: Apache-2.0
"""Serial wires that are not there: pseudo-terminals that behave like a cable to a device."""
