"""Planning of redundancy for sequences: distortion of lost packets, simulated delivery, choice of parity."""
