"""Bitstream format 2: explicit Gaussians, coded so that every packet can be decoded alone.

Each packet contains the positions of its Gaussians, and each Gaussian is predicted only from others in the same packet.
"""
