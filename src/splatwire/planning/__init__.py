"""Planning of forward error correction and retransmission by simulated transfers."""
