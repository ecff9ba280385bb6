# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with a policy or a keystore."""


class SecurityError(Exception):
    """A policy or a keystore cannot be used; says what was expected, what was found and what to do."""
