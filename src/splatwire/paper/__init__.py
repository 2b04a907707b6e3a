"""The concealers of the paper that this project implements (CARI, GNN), and the baselines of the paper.

`docs/paper-map.md` lists the code of each equation.
"""

# The package registers these concealers with `register_concealer` and the entry points of `pyproject.toml`, like any
# third-party package (docs/your-own-concealer.md). No other package imports this package.

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
