"""Publisher and receiver of streams through a relay of Media over QUIC (MoQ)."""
