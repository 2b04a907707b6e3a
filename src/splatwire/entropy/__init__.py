"""Entropy coding: integer tables and a range coder whose results are identical on every machine."""
