"""Readers and writers of explicit Gaussians, one module per format; formats are detected by a file's first bytes."""

from splatwire.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
