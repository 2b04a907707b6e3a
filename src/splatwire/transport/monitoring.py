"""Monitoring of a running server over HTTP: liveness, readiness and Prometheus metrics."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.registry import Collector

from splatwire.errors import BitstreamError
from splatwire.transport.http.messages import Request, Response, make_response, read_request
from splatwire.transport.running_server import RunningServer
from splatwire.transport.udp import UdpServer
from splatwire.version import __version__


@dataclass(frozen=True)
class MonitoringContent:
    """Content of the HTTP server for monitoring: `/healthz`, `/readyz` and `/metrics`.

    Attributes:
        running: Server to monitor.
        host: Address that the HTTP server listens on.
    """

    running: RunningServer
    host: str = "127.0.0.1"
    _registry: CollectorRegistry = field(default_factory=CollectorRegistry, init=False, repr=False)

    def __post_init__(self) -> None:
        self._registry.register(_ServerCollector(self.running))
        ProcessCollector(registry=self._registry)

    def respond_now(self, head: bytes) -> Response:
        """Returns the HTTP response to a request, given its head with the final empty line."""
        try:
            request = read_request(head)
        except BitstreamError:
            return make_response("400 Bad Request")
        return self._respond_now(request).for_method(request.method)

    def _respond_now(self, request: Request) -> Response:
        if request.method not in ("GET", "HEAD"):
            return make_response("405 Method Not Allowed", headers="Allow: GET, HEAD\r\n")
        match request.target:
            case "/healthz":
                return make_response("200 OK", body=b"ok\n")
            case "/readyz":
                reason = self.running.not_ready()
                status = "503 Service Unavailable" if reason else "200 OK"
                return make_response(status, body=f"{reason or 'ready'}\n".encode())
            case "/metrics":
                return make_response("200 OK", CONTENT_TYPE_LATEST, generate_latest(self._registry))
        return make_response("404 Not Found")

    def busy(self, head: bytes) -> Response:
        """Returns the HTTP response that refuses a request because the server is busy."""
        return make_response("503 Service Unavailable", headers="Retry-After: 1\r\n")


class _ServerCollector(Collector):
    """Prometheus collector that reads the counters of a server each time the metrics are requested."""

    def __init__(self, running: RunningServer) -> None:
        self._running = running

    def collect(self) -> Iterable[Metric]:
        """Yields the metrics of the server."""
        server, page, core = self._running.server, self._running.page, self._running.server.core
        yield InfoMetricFamily("splatwire_build", "Version of splatwire.", {"version": __version__})
        yield _gauge("ready", "1 if the server accepts transfers.", self._running.not_ready() is None)
        yield _gauge("streams", "Streams that clients can request.", core.num_streams)
        yield _gauge("transfers", "Active transfers over UDP or QUIC.", core.num_transfers)
        yield _counter("transfers_started", "Transfers that have started.", core.num_served)
        yield _counter("transfers_refused", "Requests for a transfer that were refused.", core.num_refused)
        yield _counter("transfers_failed", "Transfers that an internal error has ended.", core.num_failed)
        yield _counter("datagrams_rejected", "Invalid or repeated datagrams of clients.", core.num_rejected)
        sent = CounterMetricFamily("splatwire_sent_bytes", "Bytes sent to clients.", labels=["transport"])
        sent.add_metric(["udp" if isinstance(server, UdpServer) else "quic"], server.bytes_sent)
        if page is not None:
            sent.add_metric(["http"], page.bytes_sent)
        yield sent
        if isinstance(server, UdpServer):
            yield _counter("udp_hellos_dropped", "First datagrams over UDP that were dropped.", server.num_dropped)
        else:
            yield _gauge("quic_connections", "Open QUIC connections.", len(server.connections))
            yield _counter("quic_connections_refused", "QUIC connections that were refused.", server.num_refused)
            yield _counter("quic_connections_malformed", "QUIC connections with invalid input.", server.num_malformed)
            dropped = "QUIC connection attempts that were dropped before the handshake."
            yield _counter("quic_connections_dropped", dropped, server.num_dropped)
            excess = "Datagrams of QUIC connections that were dropped because they took too much time."
            yield _counter("quic_excess_datagrams", excess, server.num_excess)
            end = "End of the validity of the certificate, seconds since 1970."
            yield _gauge("certificate_expiry_timestamp_seconds", end, server.certificate_end)
        if page is not None:
            yield _gauge("http_responses_active", "HTTP responses that are being sent.", page.num_active)
            answers = CounterMetricFamily("splatwire_http_responses", "HTTP responses by status.", labels=["code"])
            for status, count in sorted(page.statuses.items()):
                answers.add_metric([str(status)], count)
            yield answers


def _gauge(name: str, text: str, value: int | float | bool) -> GaugeMetricFamily:
    return GaugeMetricFamily(f"splatwire_{name}", text, float(value))


def _counter(name: str, text: str, value: int | float) -> CounterMetricFamily:
    return CounterMetricFamily(f"splatwire_{name}", text, float(value))
