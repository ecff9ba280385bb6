# SPDX-License-Identifier: Apache-2.0
"""Errors of the GDFE solver."""


class GdfeError(ValueError):
    """A mesh, material, load or case that cannot be simulated: what was expected, what was found, which element or node."""
