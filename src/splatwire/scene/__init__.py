"""Nouns of the house: frozen data types of tensors, no input or output, no device choice."""

from splatwire.scene.anchors import Anchors as Anchors
from splatwire.scene.attributes import AnchorLayout as AnchorLayout
from splatwire.scene.attributes import Attribute as Attribute
from splatwire.scene.cameras import Cameras as Cameras
from splatwire.scene.erasures import Erasures as Erasures
from splatwire.scene.gaussians import Gaussians as Gaussians
