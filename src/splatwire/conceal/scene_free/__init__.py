"""The scene-free concealer: a small network in the package says how much to grow and brighten what arrived."""

from splatwire.conceal.scene_free.concealer import SceneFree as SceneFree
from splatwire.conceal.scene_free.elements import ElementNetwork as ElementNetwork
from splatwire.conceal.scene_free.network import GainNetwork as GainNetwork
from splatwire.conceal.scene_free.weights import default_weights as default_weights
from splatwire.conceal.scene_free.weights import load_gain_network as load_gain_network
from splatwire.conceal.scene_free.weights import save_gain_network as save_gain_network
