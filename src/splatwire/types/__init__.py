"""Frozen data types: scenes, Gaussians, anchors, cameras, received scenes (numpy arrays, no input or output)."""

from splatwire.lazy_names import lazy_names

_RENAMED = {"Coverage": "GrowStrength", "ExpectedPlaces": "PredictedPositions"}
"""Current name of each deprecated name."""
__all__, __getattr__, __dir__ = lazy_names(__name__, __file__, _RENAMED)
