"""Certificates for QUIC: made on the fly where there is none, and known by their fingerprint."""

import datetime
import ipaddress
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from splatwire.errors import BackendUnavailableError, InvalidValueError

DAYS = 13
"""Browsers take a certificate by its hash only if it is valid for less than 14 days."""
RENEWED_DAYS = DAYS - 1
"""Another one takes its place a day before it ends: clocks differ."""
INSTALL = "pip install 'splatwire[relay]'"


class Identity(NamedTuple):
    """What a server shows to its clients.

    Attributes:
        certificate: Its certificate.
        chain: Certificates that lead from it to one that clients know.
        key: Its private key.
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
    """The time."""
    return datetime.datetime.now(datetime.UTC)


class RenewedIdentity:
    """A certificate of our own for as long as a server runs: who asks for it after `RENEWED_DAYS` gets a new one.

    Args:
        hosts: Names and numbers by which clients call the server.
        clock: Gives the time.
        told: Called with each that takes another's place.

    Raises:
        BackendUnavailableError: If the package `cryptography` is not installed.
    """

    def __init__(
        self,
        hosts: Sequence[str] = HOSTS,
        clock: Callable[[], datetime.datetime] = utc_now,
        told: Callable[[Identity], None] = lambda identity: None,
    ) -> None:
        self._hosts, self._clock, self._told = tuple(hosts), clock, told
        self._made_at = clock()
        self._identity = self_signed(self._hosts, now=self._made_at)

    def __call__(self) -> Identity:
        """What is shown now."""
        now = self._clock()
        if now - self._made_at >= datetime.timedelta(days=RENEWED_DAYS):
            self._made_at, self._identity = now, self_signed(self._hosts, now=now)
            self._told(self._identity)
        return self._identity


def self_signed(hosts: Sequence[str] = HOSTS, days: int = DAYS, now: datetime.datetime | None = None) -> Identity:
    """Makes a certificate of its own for some hosts: an ECDSA key on P-256, as browsers want it.

    Args:
        hosts: Names and numbers by which clients call the server.
        days: How long it is valid.
        now: From when on; None for now.

    Raises:
        BackendUnavailableError: If the package `cryptography` is not installed.
    """
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import hashes
        from cryptography.hazmat.primitives.asymmetric import ec
    except ImportError as error:
        raise BackendUnavailableError("cryptography", INSTALL) from error
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "splatwire")])
    now = now or utc_now()
    names: list[x509.GeneralName] = []
    for host in dict.fromkeys(hosts):
        try:
            names.append(x509.IPAddress(ipaddress.ip_address(host)))
        except ValueError:
            names.append(x509.DNSName(host))
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
    """Reads a server's certificate (its chain behind it) and key.

    Raises:
        InvalidValueError: If they are something else, or do not belong together.
        BackendUnavailableError: If the package `cryptography` is not installed.
    """
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives.serialization import load_pem_private_key
    except ImportError as error:
        raise BackendUnavailableError("cryptography", INSTALL) from error
    try:
        first, *rest = x509.load_pem_x509_certificates(certificates)
        private: Any = load_pem_private_key(key, password=None)
    except (ValueError, TypeError) as error:
        raise InvalidValueError(f"not a certificate and an unencrypted private key in PEM: {error}") from error
    if private.public_key() != first.public_key():
        raise InvalidValueError("the private key is not that of the certificate")
    return Identity(first, tuple(rest), private)


def check_authority(certificates: bytes) -> None:
    """Refuses what is not a list of certificates in PEM.

    Raises:
        InvalidValueError: If it is not.
    """
    from cryptography import x509

    try:
        x509.load_pem_x509_certificates(certificates)
    except ValueError as error:
        raise InvalidValueError(f"not certificates in PEM: {error}") from error


def fingerprint(certificate: Any) -> str:
    """SHA-256 of a certificate, lower-case hexadecimal."""
    from cryptography.hazmat.primitives import hashes

    return bytes(certificate.fingerprint(hashes.SHA256())).hex()


def check_fingerprint(text: str) -> str:
    """A fingerprint as `fingerprint` writes it; colons, spaces and capitals do not matter.

    Raises:
        InvalidValueError: If it is not 64 hexadecimal digits.
    """
    digits = text.replace(":", "").replace(" ", "").lower()
    if len(digits) != 64 or any(digit not in "0123456789abcdef" for digit in digits):
        raise InvalidValueError(f"a fingerprint is a SHA-256 of 64 hexadecimal digits, '{text:.80}' is not")
    return digits
