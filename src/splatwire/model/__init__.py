"""The scene model: anchors with the networks that draw them and the context model that codes them."""

from splatwire.model.anchor_scene import AnchorScene as AnchorScene
from splatwire.model.anchor_scene import ContextModel as ContextModel
from splatwire.model.anchor_scene import GaussianHeads as GaussianHeads
from splatwire.model.anchor_scene import HacppCoding as HacppCoding
from splatwire.model.anchor_scene import HashGrid as HashGrid
from splatwire.model.anchor_scene import PartialScene as PartialScene
from splatwire.model.anchor_scene import RenderHints as RenderHints
from splatwire.model.config import HashGridConfig as HashGridConfig
from splatwire.model.config import ModelConfig as ModelConfig
from splatwire.model.networks import Linear as Linear
from splatwire.model.networks import Mlp as Mlp
from splatwire.model.prior import AttributePrior as AttributePrior
from splatwire.model.prior import Prior as Prior
