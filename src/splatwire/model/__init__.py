"""The scene model: anchors with the networks that draw them and the context model that codes them."""

from splatwire.model.anchor_scene import (
    AnchorScene,
    ContextModel,
    GaussianHeads,
    HacppCoding,
    HashGrid,
)
from splatwire.model.causal import CausalCoding, CausalConfig
from splatwire.model.config import HashGridConfig, ModelConfig
from splatwire.model.networks import Linear, Mlp
from splatwire.model.partial import Copies, ExpectedPlaces, Partial, TierSizes
from splatwire.model.prior import AttributePrior, Prior
from splatwire.model.scene import Coverage, RenderHints, Scene
from splatwire.model.splat_scene import SplatCoding, SplatScene

__all__ = [
    "AnchorScene",
    "AttributePrior",
    "CausalCoding",
    "CausalConfig",
    "ContextModel",
    "Copies",
    "Coverage",
    "ExpectedPlaces",
    "GaussianHeads",
    "HacppCoding",
    "HashGrid",
    "HashGridConfig",
    "Linear",
    "Mlp",
    "ModelConfig",
    "Partial",
    "Prior",
    "RenderHints",
    "Scene",
    "SplatCoding",
    "SplatScene",
    "TierSizes",
]
