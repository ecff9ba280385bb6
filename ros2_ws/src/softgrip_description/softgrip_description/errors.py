# SPDX-License-Identifier: Apache-2.0
"""The one error of this package."""


class HandError(ValueError):
    """A hand that cannot be used: says which key, what was expected, what was found, what to do."""
