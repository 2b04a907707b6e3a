"""The concealer `scene_free`: a small network predicts factors on size and opacity of received elements."""

from splatwire.concealment.scene_free.concealer import SceneFree as SceneFree
from splatwire.concealment.scene_free.elements import GaussianNetwork as GaussianNetwork
from splatwire.concealment.scene_free.network import AnchorNetwork as AnchorNetwork
from splatwire.concealment.scene_free.weights import default_anchor_weights as default_anchor_weights
from splatwire.concealment.scene_free.weights import load_anchor_network as load_anchor_network
from splatwire.concealment.scene_free.weights import save_network as save_network
