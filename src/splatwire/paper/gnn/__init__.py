"""Prior-aware GNN residual inpainting, the paper's learned concealer (Section 3.4)."""

from splatwire.paper.gnn.concealer import Gnn as Gnn
from splatwire.paper.gnn.section import SECTION as SECTION
from splatwire.paper.gnn.section import rounded_weights as rounded_weights
from splatwire.paper.gnn.section import write_section as write_section
from splatwire.paper.gnn.settings import GNN_PRESETS as GNN_PRESETS
from splatwire.paper.gnn.settings import GnnSettings as GnnSettings
from splatwire.paper.gnn.weights import GnnWeights as GnnWeights
from splatwire.paper.gnn.weights import load_weights as load_weights
from splatwire.paper.gnn.weights import save_weights as save_weights
