# SPDX-License-Identifier: Apache-2.0
"""What a sweep cannot go on with."""


class SweepError(Exception):
    """Says what was expected, what was found and what to do."""
