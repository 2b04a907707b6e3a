"""QUIC and WebTransport around the transport protocol: client, server, certificates."""
