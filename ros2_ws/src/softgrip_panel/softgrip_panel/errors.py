# SPDX-License-Identifier: Apache-2.0
"""Errors of the panel; each says what was expected, what was found, what to do."""


class PanelError(Exception):
    """Something that a person at the panel has to know."""


class ActRefusedError(PanelError):
    """An act was not done: role, control, or what it asks for does not allow it."""


class AccessError(PanelError):
    """Who asks is not known, or asks from where nobody may."""
