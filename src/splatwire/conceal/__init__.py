"""Concealment: a scene with gaps becomes one that can be rendered; what was received never changes."""

from splatwire.conceal.base import Concealed as Concealed
from splatwire.conceal.base import Concealer as Concealer
from splatwire.conceal.base import concealer_names as concealer_names
from splatwire.conceal.base import create_concealer as create_concealer
from splatwire.conceal.base import register_concealer as register_concealer
from splatwire.conceal.cari import CARI_PRESETS as CARI_PRESETS
from splatwire.conceal.cari import Cari as Cari
from splatwire.conceal.conceal import conceal as conceal
from splatwire.conceal.context import AnchorContext as AnchorContext
from splatwire.conceal.context import context_of as context_of
from splatwire.conceal.drop import Drop as Drop
from splatwire.conceal.fill import MaskVote as MaskVote
from splatwire.conceal.gnn import GNN_PRESETS as GNN_PRESETS
from splatwire.conceal.gnn import Gnn as Gnn
from splatwire.conceal.gnn import GnnSettings as GnnSettings
from splatwire.conceal.gnn import GnnWeights as GnnWeights
from splatwire.conceal.grow import Grow as Grow
from splatwire.conceal.idw import Idw as Idw
from splatwire.conceal.idw import PriorMean as PriorMean
from splatwire.conceal.kriging import Kriging as Kriging
from splatwire.conceal.scene_free import SceneFree as SceneFree
from splatwire.conceal.sketch import Sketch as Sketch
from splatwire.conceal.zero import Zero as Zero
