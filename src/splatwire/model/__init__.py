"""The scene model: anchors with the networks that draw them and the context model that codes them."""

from splatwire.model.anchor_scene import (
    AnchorScene,
    ContextModel,
    GaussianHeads,
    HacppCoding,
    HashGrid,
    PartialScene,
    RenderHints,
)
from splatwire.model.causal import CausalCoding, CausalConfig
from splatwire.model.config import HashGridConfig, ModelConfig
from splatwire.model.networks import Linear, Mlp
from splatwire.model.prior import AttributePrior, Prior
from splatwire.model.splat_scene import Copies, PartialSplats, SplatScene

__all__ = [
    "AnchorScene",
    "AttributePrior",
    "CausalCoding",
    "CausalConfig",
    "ContextModel",
    "Copies",
    "GaussianHeads",
    "HacppCoding",
    "HashGrid",
    "HashGridConfig",
    "Linear",
    "Mlp",
    "ModelConfig",
    "PartialScene",
    "PartialSplats",
    "Prior",
    "RenderHints",
    "SplatScene",
]
