# SPDX-License-Identifier: Apache-2.0
"""What keeps a node from starting."""


class StartupError(Exception):
    """A node cannot start; the message says what was expected, what was found and what to do."""
