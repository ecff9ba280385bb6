# SPDX-License-Identifier: Apache-2.0
"""The errors of this package; each says which key, what was expected, what was found, what to do."""


class HandError(ValueError):
    """A hand that cannot be used."""


class CellFileError(ValueError):
    """A cell file that cannot be used."""
