"""The viewer: a scene while it arrives, what it has lost, and how that is hidden, in a browser."""

from splatwire.view.progressive_scene import ProgressiveScene
from splatwire.view.transfer import Arrival, Transfer, plan_transfer

__all__ = [
    "Arrival",
    "ProgressiveScene",
    "Transfer",
    "plan_transfer",
]
