# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with a demonstration."""


class DesignError(Exception):
    """A demonstration or a design task cannot be used; says what was expected, what was found and what to do."""
