"""The viewer: a scene while it arrives, what it has lost, and how that is hidden, in a browser."""

from splatwire.view.progressive_scene import ProgressiveScene as ProgressiveScene
from splatwire.view.transfer import Arrival as Arrival
from splatwire.view.transfer import Transfer as Transfer
from splatwire.view.transfer import plan_transfer as plan_transfer
