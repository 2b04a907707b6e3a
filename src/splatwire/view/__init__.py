"""The viewer: a scene while it arrives, what it has lost, and how that is hidden, in a browser."""

from splatwire.view.progressive_scene import ProgressiveScene
from splatwire.view.transfer import Playback, PlayedPacket, plan_transfer

__all__ = [
    "Playback",
    "PlayedPacket",
    "ProgressiveScene",
    "plan_transfer",
]
