"""Entropy coding: integer tables, a range coder, and nothing that a machine could round differently."""
