# SPDX-License-Identifier: Apache-2.0
"""Type hashes as values."""

from __future__ import annotations

from typing import Any

_BYTES = 32


class TypeHash:
    """A version and 32 bytes."""

    __slots__ = ("_value", "_version")

    def __init__(self, version: int = -1, value: bytes = bytes(_BYTES), **kwargs: Any) -> None:
        if kwargs:
            raise AssertionError(f"Invalid arguments passed to constructor: {', '.join(sorted(kwargs))}")
        self.version = version
        self.value = value

    @classmethod
    def from_text(cls, text: str) -> TypeHash:
        """Read ``RIHS01_<64 hex digits>``."""
        head, _, digits = text.partition("_")
        if not head.startswith("RIHS") or len(digits) != 2 * _BYTES:
            return cls()
        return cls(version=int(head[4:], 16), value=bytes.fromhex(digits))

    @property
    def version(self) -> int:
        """The version of the hashing rule."""
        return self._version

    @version.setter
    def version(self, value: int) -> None:
        if not isinstance(value, int):
            raise AssertionError(f"version: expected int, found {value!r}")
        self._version = value

    @property
    def value(self) -> bytes:
        """The digest."""
        return self._value

    @value.setter
    def value(self, value: bytes) -> None:
        if not isinstance(value, bytes):
            raise AssertionError(f"value: expected bytes, found {value!r}")
        self._value = value

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TypeHash):
            return False
        return (self._version, self._value) == (other._version, other._value)

    def __hash__(self) -> int:
        return hash((self._version, self._value))

    def __str__(self) -> str:
        if self._version <= 0 or len(self._value) != _BYTES:
            return "INVALID"
        return f"RIHS{self._version:02x}_{self._value.hex()}"

    def __repr__(self) -> str:
        return f"TypeHash(version={self._version}, value={self._value!r})"
