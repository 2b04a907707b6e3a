"""The concealer `scene_free`: a small network predicts factors on size and opacity of received elements."""

from splatwire.concealment.scene_free.concealer import SceneFree as SceneFree
from splatwire.concealment.scene_free.elements import ElementNetwork as ElementNetwork
from splatwire.concealment.scene_free.network import GainNetwork as GainNetwork
from splatwire.concealment.scene_free.weights import default_weights as default_weights
from splatwire.concealment.scene_free.weights import load_gain_network as load_gain_network
from splatwire.concealment.scene_free.weights import save_gain_network as save_gain_network
