"""Concealment: a scene with gaps becomes one that can be rendered; what was received never changes."""

from splatwire.conceal.base import Concealed, Concealer, concealer_names, create_concealer, register_concealer
from splatwire.conceal.cari import CARI_PRESETS, Cari
from splatwire.conceal.conceal import conceal, concealed
from splatwire.conceal.context import AnchorContext, context_of
from splatwire.conceal.drop import Drop
from splatwire.conceal.fill import MaskVote
from splatwire.conceal.gnn import GNN_PRESETS, Gnn, GnnSettings, GnnWeights
from splatwire.conceal.grow import Grow
from splatwire.conceal.idw import Idw, PriorMean
from splatwire.conceal.kriging import Kriging
from splatwire.conceal.scene_free import SceneFree
from splatwire.conceal.sketch import Sketch
from splatwire.conceal.zero import Zero

__all__ = [
    "CARI_PRESETS",
    "GNN_PRESETS",
    "AnchorContext",
    "Cari",
    "Concealed",
    "Concealer",
    "Drop",
    "Gnn",
    "GnnSettings",
    "GnnWeights",
    "Grow",
    "Idw",
    "Kriging",
    "MaskVote",
    "PriorMean",
    "SceneFree",
    "Sketch",
    "Zero",
    "conceal",
    "concealed",
    "concealer_names",
    "context_of",
    "create_concealer",
    "register_concealer",
]
