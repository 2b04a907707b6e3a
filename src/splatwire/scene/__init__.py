"""Nouns of the house: frozen data types of tensors, no input or output, no device choice."""

from splatwire.scene.anchors import Anchors
from splatwire.scene.attributes import AnchorLayout, Attribute
from splatwire.scene.cameras import Cameras
from splatwire.scene.erasures import Erasures
from splatwire.scene.gaussians import Gaussians

__all__ = [
    "AnchorLayout",
    "Anchors",
    "Attribute",
    "Cameras",
    "Erasures",
    "Gaussians",
]
