# SPDX-License-Identifier: Apache-2.0
"""The folder of keys: made, renewed and checked. Its layout is that of an SROS2 keystore, with Zenoh's files beside.

    public/ca.cert.pem, private/ca.key.pem       the cell's authority; identity_ca and permissions_ca point to it
    enclaves/governance.p7s                      rules of the domain (DDS)
    enclaves/softgrip/NAME/                      cert.pem, key.pem, permissions.p7s of one identity
    zenoh/NAME.json5, zenoh/router.json5         configuration of its session, and of the router
    policy.xml                                   the policy as sros2 and zenoh_security_tools read it

Folders are 0700 and files 0600, and belong to whoever made them. Keys and certificates are made where there are none;
they are replaced only when asked for. All else follows from policy and keys, and is written whenever it differs.
"""

from __future__ import annotations

import datetime as dt
import json
import os
import stat
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from softgrip_security import sros2, zenoh_access
from softgrip_security.certificates import (
    Credential,
    make_authority,
    make_certificate,
    read_credential,
    sign_document,
)
from softgrip_security.errors import SecurityError
from softgrip_security.policy import ROUTER, Policy, PolicyIdentity

#: How long a certificate is good, and how long before its end it is reported.
DAYS = 397
RENEW_DAYS = 30
_PRIVATE_FOLDER = 0o700
_PRIVATE_FILE = 0o600
_OTHERS = 0o077


@dataclass(frozen=True)
class Report:
    """What has been done to a keystore, for a person to read."""

    made: tuple[str, ...] = ()
    written: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


class Keystore:
    """One folder of keys.

    Args:
        folder: where it is or shall be.
        policy: who is who, and may do what.
        hosts: names of the cell's machines, the router's first; they go into certificates.
        now: the time, UTC; the present where it is not given.
    """

    def __init__(
        self,
        folder: Path,
        policy: Policy,
        hosts: Iterable[str] = ("localhost",),
        now: dt.datetime | None = None,
    ) -> None:
        self._folder = folder.expanduser().absolute()
        self._policy = policy
        self._hosts = tuple(hosts)
        self._now = now or dt.datetime.now(dt.UTC)
        self._made: list[str] = []
        self._written: list[str] = []

    def make(self, days: int = DAYS) -> Report:
        """Make what is missing, and write what follows from policy and keys where it differs.

        Raises:
            SecurityError: the folder is open to others, or holds something else.
        """
        self._make_folders()
        authority = self._authority()
        for name, enclave in self._enclaves().items():
            self._make_certificate(authority, name, enclave, days)
        self._write_dds(authority)
        self._write_zenoh()
        return Report(tuple(self._made), tuple(self._written), tuple(self.warnings()))

    def rotate(self, days: int = DAYS, *, authority: bool = False) -> Report:
        """Replace every key and certificate; with ``authority`` the cell's authority as well.

        Old certificates stay good for who has a copy of them until they run out, unless the authority is replaced.

        Raises:
            SecurityError: as for make, or there is no keystore here.
        """
        self._require()
        for enclave in self._enclaves().values():
            for name in ("key.pem", "cert.pem"):
                (enclave / name).unlink(missing_ok=True)
        if authority:
            self._ca_key.unlink(missing_ok=True)
            self._ca_certificate.unlink(missing_ok=True)
        return self.make(days)

    def warnings(self) -> list[str]:
        """Return what is wrong or soon will be: open files, another policy, certificates that end, missing keys.

        Raises:
            SecurityError: there is no keystore here.
        """
        self._require()
        found = [text for path in sorted(self._folder.rglob("*")) if (text := exposure(path)) is not None]
        if not self._policy_file.is_file() or self._policy_file.read_bytes() != sros2.policy_xml(self._policy):
            found.append(
                f"{self._policy_file}: expected the rules of this access policy and namespace, found others: what is "
                "new in the policy is refused; write the rules again with `make keys`, which replaces no key"
            )
        for name, enclave in self._enclaves().items():
            try:
                credential = _read(enclave / "cert.pem", enclave / "key.pem")
            except SecurityError as error:
                found.append(f"{name}: {error}")
                continue
            left = (credential.valid_until - self._now).days
            if left < RENEW_DAYS:
                end = credential.valid_until.date()
                found.append(f"{name}: the certificate ends {end}, in {left} days; renew with --rotate")
        known = self._enclaves()
        folders = sorted((self._folder / "enclaves" / "softgrip").glob("*"))
        found += [
            f"{one.name}: has keys and no place in the policy; delete {one}" for one in folders if one.name not in known
        ]
        return found

    # -- folders and files ------------------------------------------------------------------------------------------

    @property
    def _policy_file(self) -> Path:
        return self._folder / "policy.xml"

    @property
    def _ca_key(self) -> Path:
        return self._folder / "private" / "ca.key.pem"

    @property
    def _ca_certificate(self) -> Path:
        return self._folder / "public" / "ca.cert.pem"

    def _enclaves(self) -> Mapping[str, Path]:
        """Return the folder of each identity, the router among them."""
        base = self._folder / "enclaves"
        return {name: base / "softgrip" / name for name in (*(one.name for one in self._policy.identities), ROUTER)}

    def _require(self) -> None:
        if not self._ca_certificate.is_file():
            raise SecurityError(f"{self._folder}: expected a keystore, found none; make it with `make keys`")

    def _make_folders(self) -> None:
        if self._folder.is_dir() and any(self._folder.iterdir()) and not (self._folder / "public").is_dir():
            raise SecurityError(f"{self._folder}: expected a keystore or an empty folder, found other files")
        folders = [self._folder, *(self._folder / name for name in ("public", "private", "enclaves", "zenoh"))]
        for folder in [*folders, self._folder / "enclaves" / "softgrip", *self._enclaves().values()]:
            folder.mkdir(mode=_PRIVATE_FOLDER, parents=True, exist_ok=True)
            if (text := exposure(folder)) is not None:
                raise SecurityError(text)

    def _write(self, path: Path, data: bytes) -> None:
        """Write a file that only its owner can read, whole or not at all; nothing where it is the same already."""
        if path.is_file() and path.read_bytes() == data:
            return
        draft = path.with_name(f".{path.name}.new")
        draft.unlink(missing_ok=True)
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _PRIVATE_FILE), "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
        self._written.append(str(path.relative_to(self._folder)))

    def _link(self, path: Path, target: Path) -> None:
        relative = os.path.relpath(target, path.parent)
        if not path.is_symlink() or str(path.readlink()) != relative:
            path.unlink(missing_ok=True)
            path.symlink_to(relative)

    # -- keys -------------------------------------------------------------------------------------------------------

    def _authority(self) -> Credential:
        """Return the cell's authority; make it where there is none."""
        if self._ca_certificate.is_file() != self._ca_key.is_file():
            raise SecurityError(
                f"{self._folder}: expected the authority's certificate and its key, found one of them; "
                f"bring {self._ca_key} back from where it is kept, or make a new authority with --new-authority"
            )
        if not self._ca_key.is_file():
            if any((enclave / "key.pem").exists() for enclave in self._enclaves().values()):
                raise SecurityError(
                    f"{self._folder}: expected the authority that signed these keys, found none; "
                    "bring it back, or replace everything with --new-authority"
                )
            made = make_authority(self._now)
            self._write(self._ca_key, made.key_pem)
            self._write(self._ca_certificate, made.certificate_pem)
            self._made.append("authority")
        for kind in ("identity", "permissions"):
            self._link(self._folder / "public" / f"{kind}_ca.cert.pem", self._ca_certificate)
            self._link(self._folder / "private" / f"{kind}_ca.key.pem", self._ca_key)
        return _read(self._ca_certificate, self._ca_key)

    def _make_certificate(self, authority: Credential, name: str, enclave: Path, days: int) -> None:
        """Make an identity's key and certificate where it has none."""
        key, certificate = enclave / "key.pem", enclave / "cert.pem"
        if not key.exists() and not certificate.exists():
            made = make_certificate(authority, f"/softgrip/{name}", self._hosts, self._now, days)
            self._write(key, made.key_pem)
            self._write(certificate, made.certificate_pem)
            self._made.append(name)
        for kind in ("identity", "permissions"):
            self._link(enclave / f"{kind}_ca.cert.pem", self._folder / "public" / f"{kind}_ca.cert.pem")
        self._link(enclave / "governance.p7s", self._folder / "enclaves" / "governance.p7s")

    # -- what follows from policy and keys ------------------------------------------------------------------------

    def _write_dds(self, authority: Credential) -> None:
        self._write(self._policy_file, sros2.policy_xml(self._policy))
        self._write_signed(authority, self._folder / "enclaves" / "governance", sros2.governance_xml())
        for name, enclave in self._enclaves().items():
            credential = _read(enclave / "cert.pem", enclave / "key.pem")
            identity = PolicyIdentity(ROUTER, ()) if name == ROUTER else self._policy.identity(name)
            text = sros2.permissions_xml(identity, credential.valid_from, credential.valid_until)
            self._write_signed(authority, enclave / "permissions", text)

    def _write_signed(self, authority: Credential, stem: Path, text: bytes) -> None:
        """Write STEM.xml and STEM.p7s. Each signature differs, so one is made only for a new text or authority."""
        document, signed = stem.with_suffix(".xml"), stem.with_suffix(".p7s")
        is_current = document.is_file() and document.read_bytes() == text and signed.is_file()
        if not is_current or "authority" in self._made:
            self._write(document, text)
            self._write(signed, sign_document(authority, text))

    def _write_zenoh(self) -> None:
        for name, enclave in self._enclaves().items():
            make = zenoh_access.router_config if name == ROUTER else zenoh_access.session_config
            values = make(self._policy, enclave, self._hosts)
            self._write(self._folder / "zenoh" / f"{name}.json5", json.dumps(values, indent=1).encode())


def exposure(path: Path) -> str | None:
    """Return how a file or folder is open to others than this user; None when it is not."""
    found = path.lstat()
    if stat.S_ISLNK(found.st_mode):
        return None
    if found.st_uid != os.getuid():
        return f"{path}: expected to belong to user {os.getuid()}, found user {found.st_uid}; chown it"
    if found.st_mode & _OTHERS:
        return f"{path}: expected no access for others, found mode {stat.S_IMODE(found.st_mode):04o}; chmod go= it"
    return None


def _read(certificate: Path, key: Path) -> Credential:
    try:
        return read_credential(certificate.read_bytes(), key.read_bytes())
    except OSError as error:
        raise SecurityError(f"expected {error.filename}, found: {error.strerror}") from error
    except SecurityError as error:
        raise SecurityError(f"{key.parent}: {error}") from error
