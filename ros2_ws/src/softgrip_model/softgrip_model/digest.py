# SPDX-License-Identifier: Apache-2.0
"""Short names for what a number depends on."""

from __future__ import annotations

# hashlib would load OpenSSL, 3.5 MB in each node, for the same function.
try:
    from _sha256 import sha256
except ImportError:
    try:
        from _sha2 import sha256  # Python 3.12 and later
    except ImportError:
        from hashlib import sha256


def text_sha256(text: str) -> str:
    """Return the SHA-256 of the text in 64 hex digits."""
    digest: str = sha256(text.encode()).hexdigest()
    return digest


def text_digest(text: str) -> str:
    """Return the first sixteen hex digits of the text's SHA-256."""
    return text_sha256(text)[:16]
