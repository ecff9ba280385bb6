# SPDX-License-Identifier: Apache-2.0
"""Errors of the GDFE solver."""


class GdfeError(ValueError):
    """What cannot be simulated: what was expected, what was found, which element or node."""
