# SPDX-License-Identifier: Apache-2.0
"""What keeps a node from starting, and what ends one that runs."""


class StartupError(Exception):
    """A node cannot start; the message says what was expected, what was found and what to do."""


class FatalError(Exception):
    """A node cannot go on: raised by a callback, it ends the process with exit code 1 (`run`); any other does not."""
