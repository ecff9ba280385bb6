# SPDX-License-Identifier: Apache-2.0
"""Make the cell's own certificate authority, the certificates of its identities, and signed documents.

Curve P-256 and SHA-256, as DDS Security 1.1 (9.3.1) asks for and as sros2 makes them, so that one keystore serves DDS
and Zenoh.
"""

from __future__ import annotations

import datetime as dt
import ipaddress
import re
from collections.abc import Iterable
from dataclasses import dataclass

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import pkcs7

from softgrip_security.errors import SecurityError

CA_NAME = "softgrip CA"
CA_DAYS = 3650
#: A certificate is good from yesterday on: clocks differ.
_BEFORE = dt.timedelta(days=1)
_HOST_NAME = re.compile(r"(?!-)[A-Za-z0-9-]+(?:\.[A-Za-z0-9-]+)*")


@dataclass(frozen=True)
class Credential:
    """A certificate and its private key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @property
    def valid_from(self) -> dt.datetime:
        """Return when the certificate begins to be good (UTC)."""
        return self._utc("not_valid_before")

    @property
    def valid_until(self) -> dt.datetime:
        """Return when the certificate ends (UTC)."""
        return self._utc("not_valid_after")

    def _utc(self, name: str) -> dt.datetime:
        # cryptography has times with a zone from 42 on; Ubuntu 24.04 has 41, whose times are UTC without saying so
        aware: dt.datetime | None = getattr(self.certificate, f"{name}_utc", None)
        if aware is not None:
            return aware
        naive: dt.datetime = getattr(self.certificate, name)
        return naive.replace(tzinfo=dt.UTC)

    @property
    def certificate_pem(self) -> bytes:
        """Return the certificate as PEM."""
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    @property
    def key_pem(self) -> bytes:
        """Return the private key as PEM (PKCS 8, not encrypted)."""
        return self.key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )


def make_authority(now: dt.datetime, days: int = CA_DAYS) -> Credential:
    """Return a new certificate authority that signs itself and nothing but end certificates."""
    key = ec.generate_private_key(ec.SECP256R1())
    builder = _builder(_common_name(CA_NAME), _common_name(CA_NAME), key, now, days)
    usage = x509.KeyUsage(
        digital_signature=True,  # permissions and governance
        key_cert_sign=True,
        crl_sign=True,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    return Credential(builder.add_extension(usage, critical=True).sign(key, hashes.SHA256()), key)


def make_certificate(
    authority: Credential, common_name: str, hosts: Iterable[str], now: dt.datetime, days: int
) -> Credential:
    """Return a new key and its certificate.

    Args:
        authority: that signs it.
        common_name: the identity's enclave.
        hosts: names and addresses at which it may be reached; localhost is always among them.
        now: today, UTC.
        days: how long it is good.

    Raises:
        SecurityError: a host is no host name and no address.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    names = [_host(name) for name in dict.fromkeys(["localhost", "127.0.0.1", "::1", *hosts])]
    builder = _builder(_common_name(common_name), authority.certificate.subject, key, now, days)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return Credential(builder.sign(authority.key, hashes.SHA256()), key)


def read_credential(certificate_pem: bytes, key_pem: bytes) -> Credential:
    """Return what two PEM files hold.

    Raises:
        SecurityError: they are not a certificate and its private key on P-256.
    """
    try:
        certificate = x509.load_pem_x509_certificate(certificate_pem)
        key = serialization.load_pem_private_key(key_pem, password=None)
    except ValueError as error:
        raise SecurityError(f"expected a certificate and a private key in PEM, found: {error}") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
        raise SecurityError("expected a private key of curve P-256 that fits its certificate, found another one")
    return Credential(certificate, key)


def sign_document(authority: Credential, text: bytes) -> bytes:
    """Return a document in clear text with its S/MIME signature, the form of governance.p7s and permissions.p7s."""
    builder = pkcs7.PKCS7SignatureBuilder().set_data(text)
    builder = builder.add_signer(authority.certificate, authority.key, hashes.SHA256())
    options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
    return builder.sign(serialization.Encoding.SMIME, options)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, now: dt.datetime, days: int
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _BEFORE)
        .not_valid_after(now + dt.timedelta(days=days))
    )


def _common_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(x509.oid.NameOID.COMMON_NAME, name)])


def _host(name: str) -> x509.GeneralName:
    if _HOST_NAME.fullmatch(name) and not name.replace(".", "").isdigit():
        return x509.DNSName(name)
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError as error:
        raise SecurityError(f"host: expected a host name or an address, found {name!r}") from error
