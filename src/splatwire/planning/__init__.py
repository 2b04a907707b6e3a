"""Planning of forward error correction and retransmission by simulated transfers and measured distortion of losses."""
