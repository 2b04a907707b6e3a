"""TLS certificates for QUIC: self-signed certificates, PEM files and fingerprints; needs the package `cryptography`."""

import datetime
import ipaddress
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from splatwire.errors import InvalidValueError

DAYS = 13
"""Validity in days. Browsers accept a certificate by its hash only if it is valid for less than 14 days."""
RENEWED_DAYS = DAYS - 1
"""Age in days at which a certificate is replaced: one day before it expires, because clocks differ."""


class Identity(NamedTuple):
    """TLS identity of a server.

    Attributes:
        certificate: Certificate of the server.
        chain: Intermediate certificates, each signed by the next, up to an authority that clients trust.
        key: Private key of the certificate.
    """

    certificate: Any
    chain: tuple[Any, ...]
    key: Any

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the certificate, lower-case hexadecimal."""
        return fingerprint(self.certificate)


HOSTS = ("localhost", "127.0.0.1", "::1")


def utc_now() -> datetime.datetime:
    """Returns the current time in UTC."""
    return datetime.datetime.now(datetime.UTC)


class RenewedIdentity:
    """Self-signed certificate that is renewed regularly, for servers that run for a long time.

    Call the object to get the current certificate and key.

    Args:
        hosts: Host names and IP addresses of the server, which the certificate contains.
        clock: Function that returns the current time in UTC.
        on_renewed: Function that is called with each renewed certificate and its key, not with the first certificate.
    """

    def __init__(
        self,
        hosts: Sequence[str] = HOSTS,
        clock: Callable[[], datetime.datetime] = utc_now,
        on_renewed: Callable[[Identity], None] = lambda identity: None,
    ) -> None:
        self._hosts, self._clock, self._on_renewed = tuple(hosts), clock, on_renewed
        self._made_at = clock()
        self._identity = self_signed(self._hosts, now=self._made_at)

    def __call__(self) -> Identity:
        """Returns the current certificate and key, renewed if too old."""
        now = self._clock()
        if now - self._made_at >= datetime.timedelta(days=RENEWED_DAYS):
            self._made_at, self._identity = now, self_signed(self._hosts, now=now)
            self._on_renewed(self._identity)
        return self._identity


class FileIdentity:
    """Certificate and private key from PEM files; call the object to get the current ones.

    Args:
        certificate: Path of the certificate, followed by its intermediate certificates.
        key: Path of the private key of the certificate.

    Raises:
        InvalidValueError: If the data are not valid PEM, or the key does not match the certificate.
        OSError: If a file cannot be read.
    """

    def __init__(self, certificate: Path, key: Path) -> None:
        self._certificate, self._key = certificate, key
        self.reload()

    def __call__(self) -> Identity:
        """Returns the current certificate and key."""
        return self._identity

    def reload(self) -> None:
        """Reads certificate and key from their files again.

        After an error, the previous certificate and key stay in use.

        Raises:
            InvalidValueError: If the data are not valid PEM, or the key does not match the certificate.
            OSError: If a file cannot be read.
        """
        self._identity = from_pem(self._certificate.read_bytes(), self._key.read_bytes())


def self_signed(hosts: Sequence[str] = HOSTS, days: int = DAYS, now: datetime.datetime | None = None) -> Identity:
    """Creates a self-signed certificate with an ECDSA key on P-256.

    Args:
        hosts: Host names and IP addresses of the server, which the certificate contains.
        days: Validity in days.
        now: Start of the validity; None for the current time.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "splatwire")])
    now = now or utc_now()
    names: list[x509.GeneralName] = []
    for host in dict.fromkeys(hosts):
        try:
            names.append(x509.IPAddress(ipaddress.ip_address(host)))
        except ValueError:
            with suppress(UnicodeError):  # no host name: the server cannot listen there, and says so
                names.append(x509.DNSName(host.encode("idna").decode()))
    builder = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))  # clocks differ
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    )
    return Identity(builder.sign(key, hashes.SHA256()), (), key)


def from_pem(certificates: bytes, key: bytes) -> Identity:
    """Parses the certificate and the private key of a server from PEM data.

    Args:
        certificates: PEM data: certificate of the server, followed by its intermediate certificates.
        key: PEM data: private key of the certificate.

    Raises:
        InvalidValueError: If the data are not valid PEM, or the key does not match the certificate.
    """
    try:
        first, *rest = x509.load_pem_x509_certificates(certificates)
        private: Any = load_pem_private_key(key, password=None)
    except (ValueError, TypeError) as error:
        raise InvalidValueError(f"not a certificate and an unencrypted private key in PEM: {error}") from error
    if private.public_key() != first.public_key():
        raise InvalidValueError("the private key is not that of the certificate")
    return Identity(first, tuple(rest), private)


def check_authority(certificates: bytes) -> None:
    """Checks that the data are a list of PEM certificates.

    Raises:
        InvalidValueError: If a certificate is malformed.
    """
    try:
        x509.load_pem_x509_certificates(certificates)
    except ValueError as error:
        raise InvalidValueError(f"not certificates in PEM: {error}") from error


def fingerprint(certificate: Any) -> str:
    """Returns the SHA-256 of a certificate in lower-case hexadecimal."""
    return bytes(certificate.fingerprint(hashes.SHA256())).hex()


def check_fingerprint(text: str) -> str:
    """Normalises the SHA-256 fingerprint of a certificate: removes colons and spaces, converts to lower case.

    Raises:
        InvalidValueError: If the text does not have 64 hexadecimal digits.
    """
    digits = text.replace(":", "").replace(" ", "").lower()
    if len(digits) != 64 or any(digit not in "0123456789abcdef" for digit in digits):
        raise InvalidValueError(f"a fingerprint is a SHA-256 of 64 hexadecimal digits, '{text:.80}' is not")
    return digits
