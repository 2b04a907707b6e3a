"""Frozen data types: scenes, Gaussians, anchors, cameras, received scenes (numpy arrays, no input or output)."""

from splatwire.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
