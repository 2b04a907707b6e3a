"""Options common to several subcommands."""

# This module imports no heavy library, like all modules with options.

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import tyro

JsonFlag = Annotated[bool, tyro.conf.arg(name="json")]
BackgroundOption: TypeAlias = tuple[float, float, float] | None
"""Value of `--background`, RGB from 0 to 1; None for the background of the scene."""
OutliersOption: TypeAlias = Literal["clamp", "prune", "keep"] | None
"""Value of `--outliers`; None for the default."""


def quality_option(value: str) -> str | float:
    """Converts a value of `--quality`: a number from 0 to 100, or a name."""
    try:
        return float(value)
    except ValueError:
        return value


@dataclass(frozen=True, kw_only=True)
class Listening:
    """Options of the subcommands that serve: address, rate, transport, log."""

    port: int = 4840
    """UDP port; 0 lets the system choose."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 for all IPv4 addresses of this machine, :: for IPv6, too."""
    rate: float | None = None
    """Fixed rate for each client in megabits per second. Default: adapted to the path."""
    total_rate: float | None = None
    """Maximum rate to all clients together in megabits per second, over UDP, QUIC and HTTP."""
    clients: int = 256
    """Maximum number of clients at the same time."""
    clients_per_address: int = 16
    """Maximum number of clients per IPv4 address or IPv6 /64 prefix; twice as many may start per minute."""
    quic: bool = False
    """Serve over QUIC: encrypted, with the side information on a reliable stream. Browsers connect by WebTransport."""
    page: int | None = None
    """TCP port of a web page that receives and renders the streams; 0 lets the system choose. Implies --quic."""
    public_url: str | None = None
    """With --page: public address of the page, e.g. https://splats.example.org, behind a proxy."""
    proxy: tuple[str, ...] = ()
    """With --page: addresses or networks of trusted proxies, e.g. 127.0.0.1. Their header X-Forwarded-For gives the
    address of the visitor, to which limits and the log apply."""
    certificate: Path | None = None
    """With --quic: certificate and its chain (PEM). Default: a generated certificate, whose fingerprint is printed."""
    key: Path | None = None
    """Private key of the certificate (PEM, not encrypted)."""
    monitor: str | None = None
    """Serve /healthz, /readyz and /metrics (Prometheus) on this TCP port, or on HOST:PORT; 127.0.0.1 if no host."""
    log_level: Literal["debug", "info", "warning", "error"] = "warning"
    """Lowest level of the log on standard error; info has a line for each transfer and each HTTP response."""
    log_format: Literal["text", "json"] = "text"
    """Format of the log: text, or one JSON object a line."""
    json: JsonFlag = False
    """Print one JSON object when ready."""

    @property
    def over_quic(self) -> bool:
        """True if streams are served over QUIC instead of plain UDP."""
        return self.quic or self.page is not None

    @property
    def fixed_rate(self) -> float | None:
        """Send rate for each client in bytes per second; None for adaptive congestion control."""
        return None if self.rate is None else self.rate * 1e6 / 8

    @property
    def total_bytes_s(self) -> float | None:
        """Maximum rate to all clients together in bytes per second; None for no maximum."""
        return None if self.total_rate is None else self.total_rate * 1e6 / 8


@dataclass(frozen=True)
class TrustOptions:
    """Checks of the certificate of a server or relay. By default, a trusted authority must have signed it."""

    fingerprint: str | None = None
    """Not with udp://: SHA-256 of the server's certificate, as printed by the server; replaces all other checks."""
    authority: Path | None = None
    """Not with udp://: PEM file with the certificate of the server, or of the authority that signed it."""
    insecure: bool = False
    """Not with udp://: accept any certificate; an attacker on the path can then pose as the server."""

    @property
    def given(self) -> bool:
        """True if at least one of the options for certificate checks is set."""
        return bool(self.fingerprint is not None or self.authority is not None or self.insecure)


@dataclass(frozen=True)
class RelayTrustOptions(TrustOptions):
    """With --moq only: how the relay's certificate is checked. By default, a trusted authority must have signed it."""

    fingerprint: str | None = None
    """With --moq: SHA-256 of the relay's certificate; replaces all other checks."""
    authority: Path | None = None
    """With --moq: PEM file with the certificate of the relay, or of the authority that signed it."""
    insecure: bool = False
    """With --moq: take any certificate; an attacker on the path can pose as the relay."""
