"""Codecs of neural anchors: HAC++ streams (format 1) and the causal model (format 2)."""
