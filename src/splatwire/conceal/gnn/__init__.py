"""Prior-aware GNN residual inpainting, the paper's learned concealer (Section 3.4)."""

from splatwire.conceal.gnn.concealer import Gnn as Gnn
from splatwire.conceal.gnn.section import SECTION as SECTION
from splatwire.conceal.gnn.section import rounded_weights as rounded_weights
from splatwire.conceal.gnn.section import write_section as write_section
from splatwire.conceal.gnn.settings import GNN_PRESETS as GNN_PRESETS
from splatwire.conceal.gnn.settings import GnnSettings as GnnSettings
from splatwire.conceal.gnn.weights import GnnWeights as GnnWeights
from splatwire.conceal.gnn.weights import load_weights as load_weights
from splatwire.conceal.gnn.weights import save_weights as save_weights
