# SPDX-License-Identifier: Apache-2.0
"""Take passwords out of parameters before they go into a bag, which is handed around.

A softgrip node refuses a password in its parameters; nodes of others do not. Source of the forms: RFC 3986, section
3.2.1 (user:password@ in a URL); PostgreSQL manual, "Connection Strings" (password=...).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

REDACTED = "***"
_SECRET_NAME = re.compile(r"(password|passwd|passphrase|secret|token|credential|api_?key|private_?key)", re.IGNORECASE)
_IN_URL = re.compile(r"(?<=://)([^/?#\s:@]*):[^/?#\s]*@")
_IN_WORDS = re.compile(r"\b(password|passwd|pwd|secret|token|sslpassword)(\s*=\s*)('[^']*'|[^\s&;]+)", re.IGNORECASE)


def redact_text(text: str) -> str:
    """Return a text without the passwords of URLs and connection strings in it."""
    return _IN_WORDS.sub(rf"\1\2{REDACTED}", _IN_URL.sub(rf"\1:{REDACTED}@", text))


def redact_value(name: str, value: Any) -> Any:
    """Return a parameter's value without secrets: whole when the name says so, else what its text shows."""
    if isinstance(value, str):
        return REDACTED if value and _SECRET_NAME.search(name) else redact_text(value)
    if isinstance(value, (list, tuple)):
        return [redact_value(name, element) for element in value]
    if isinstance(value, (bytes, bytearray)):
        return REDACTED if value and _SECRET_NAME.search(name) else value
    return value


def redact(values: Mapping[str, object]) -> tuple[dict[str, object], list[str]]:
    """Return parameters without secrets, and the names of those that had one."""
    clean = {name: redact_value(name, value) for name, value in values.items()}
    return clean, [name for name, value in values.items() if clean[name] != _as_list(value)]


def _as_list(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value
