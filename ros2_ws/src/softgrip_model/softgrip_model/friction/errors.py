# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with friction data and models; a message says what was expected, what was found and what to do."""

from __future__ import annotations


class FrictionError(Exception):
    """Base of the family."""


class LawError(FrictionError):
    """Coefficients or a radius that no friction law can have."""


class DataError(FrictionError):
    """Measured points that cannot be used; names the row where there is one."""


class ModelFileError(FrictionError):
    """A model file that is missing, damaged or of another schema."""
