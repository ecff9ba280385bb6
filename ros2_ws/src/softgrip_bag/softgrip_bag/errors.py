# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with a bag."""


class BagError(Exception):
    """A bag cannot be written or read; the message says what was expected, what was found and what to do."""
