"""Bitstream format 2: explicit Gaussians, coded so that every packet can be decoded alone."""
