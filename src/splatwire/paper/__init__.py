"""The concealers of the paper that this project was built for, and those that they were measured against.

They come in by `register_concealer` and the entry points of `pyproject.toml`, as those of any other package do
(docs/your-own-concealer.md); no other room imports this one. `docs/paper-map.md` says which equation is where.
"""

from splatwire.paper.cari import CARI_PRESETS, Cari
from splatwire.paper.fill import MaskVote
from splatwire.paper.gnn import GNN_PRESETS, Gnn, GnnSettings, GnnWeights
from splatwire.paper.idw import Idw, PriorMean
from splatwire.paper.kriging import Kriging
from splatwire.paper.zero import Zero

__all__ = [
    "CARI_PRESETS",
    "GNN_PRESETS",
    "Cari",
    "Gnn",
    "GnnSettings",
    "GnnWeights",
    "Idw",
    "Kriging",
    "MaskVote",
    "PriorMean",
    "Zero",
]
