# SPDX-License-Identifier: Apache-2.0
"""People who may log in: a file of names, roles and scrypt hashes; no password is kept anywhere."""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
import unicodedata
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from softgrip_panel.errors import AccessError
from softgrip_panel.model.roles import Role
from softgrip_panel.texts import say

#: RFC 7914; 2^15 blocks of 1 KiB take 32 MiB; a setting that OWASP's password storage cheat sheet names.
SCRYPT_N: Final = 2**15
SCRYPT_R: Final = 8
SCRYPT_P: Final = 3
_MAX_MEMORY: Final = 64 * 1024 * 1024
MIN_PASSWORD: Final = 8
MAX_PASSWORD: Final = 200
MAX_NAME: Final = 40
_KIND: Final = "softgrip_panel_users"


@dataclass(frozen=True)
class Account:
    """One line of the file."""

    name: str
    role: Role
    salt: bytes
    digest: bytes


def check_name(name: str) -> str:
    """Return a person's name without blanks around it.

    Raises:
        AccessError: empty, too long, or with characters that do not print.
    """
    plain = unicodedata.normalize("NFC", name).strip()
    if not 1 <= len(plain) <= MAX_NAME or not plain.isprintable():
        raise AccessError(say("error.name", limit=MAX_NAME, found=len(plain)))
    return plain


class Accounts:
    """The accounts of a file; an empty path has none and lets anybody at this machine in with a name.

    Args:
        file: of the accounts, None = nobody needs a password.
    """

    def __init__(self, file: Path | None) -> None:
        self._file = file
        self._by_name: dict[str, Account] = {} if file is None else _read(file)
        self._nobody = Account("", Role.LOOK, secrets.token_bytes(16), secrets.token_bytes(32))

    @property
    def need_password(self) -> bool:
        """Whether people have to prove who they are."""
        return self._file is not None

    @property
    def names(self) -> tuple[str, ...]:
        """Who may log in."""
        return tuple(self._by_name)

    def role_of(self, name: str, password: str) -> Role | None:
        """Return the role of who gives the right password, None for all others; takes as long for both."""
        account = self._by_name.get(name, self._nobody)
        given = _digest(password[:MAX_PASSWORD], account.salt)
        is_right = hmac.compare_digest(given, account.digest)
        return account.role if is_right and name in self._by_name else None


def add_account(file: Path, name: str, role: Role, password: str) -> None:
    """Write an account, new or in place of an older one of that name.

    Raises:
        AccessError: the password is too short, or the file cannot be read.
    """
    name = check_name(name)
    if not MIN_PASSWORD <= len(password) <= MAX_PASSWORD:
        raise AccessError(say("error.password", low=MIN_PASSWORD, high=MAX_PASSWORD, found=len(password)))
    accounts = _read(file) if file.exists() else {}
    salt = secrets.token_bytes(16)
    accounts[name] = Account(name, role, salt, _digest(password, salt))
    _write(file, accounts)


def remove_account(file: Path, name: str) -> None:
    """Take an account out.

    Raises:
        AccessError: there is none of that name.
    """
    accounts = _read(file)
    if name not in accounts:
        raise AccessError(say("error.account", file=file, known=", ".join(accounts), found=name))
    del accounts[name]
    _write(file, accounts)


def _digest(password: str, salt: bytes) -> bytes:
    secret = unicodedata.normalize("NFKC", password).encode()
    return hashlib.scrypt(secret, salt=salt, n=SCRYPT_N, r=SCRYPT_R, p=SCRYPT_P, maxmem=_MAX_MEMORY, dklen=32)


def _read(file: Path) -> dict[str, Account]:
    try:
        mode = file.stat().st_mode
        document = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise AccessError(say("error.users_unreadable", file=file, error=error)) from error
    if mode & 0o077:
        raise AccessError(say("error.users_mode", file=file, found=f"{mode & 0o777:o}"))
    if not isinstance(document, dict) or document.get("kind") != _KIND or not isinstance(document.get("users"), dict):
        raise AccessError(say("error.users_kind", file=file, kind=_KIND))
    return {str(name): _account(file, str(name), entry) for name, entry in document["users"].items()}


def _account(file: Path, name: str, entry: Any) -> Account:
    try:
        return Account(
            check_name(name),
            Role[str(entry["role"]).upper()],
            bytes.fromhex(entry["salt"]),
            bytes.fromhex(entry["scrypt"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise AccessError(say("error.users_entry", file=file, name=name, error=error)) from error


def _write(file: Path, accounts: dict[str, Account]) -> None:
    users = {
        one.name: {"role": one.role.word, "salt": one.salt.hex(), "scrypt": one.digest.hex()}
        for one in accounts.values()
    }
    text = yaml.safe_dump({"kind": _KIND, "schema": 1, "users": users}, sort_keys=False, allow_unicode=True)
    part = file.with_name(f".{file.name}.part")
    file.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as out:
        out.write(text)
        out.flush()
        os.fsync(out.fileno())
    part.replace(file)
