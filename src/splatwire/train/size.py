"""A size that the stream of a scene is to have: lambda is steered by what the real coder makes of the scene."""

import math

from splatwire.codec.encoding import encode_anchors
from splatwire.model import AnchorScene
from splatwire.packets import stream_to_bytes
from splatwire.train.config import Marks, TrainConfig
from splatwire.train.export import export_scene
from splatwire.train.state import Steering, TrainState

TIMES = 30
"""How often a run is measured."""
PROPORTIONAL, INTEGRAL = 2.0, 0.7
"""By how much the logarithm of lambda follows a change of the logarithm of the size, and what is still missing of it.
Size falls with about the root of lambda, within some hundred of 2,400 iterations: it is approached without swinging."""
FURTHEST = math.log(64)
"""Lambda stays within this of the recipe's."""


def steer(state: TrainState, config: TrainConfig) -> None:
    """Changes lambda where it is time to, so that the stream comes out at the size that the recipe asks for.

    Args:
        state: After an iteration; its steering is replaced.
        config: The recipe.

    Raises:
        InvalidValueError: If no anchor is left.
    """
    if config.weights.size and is_time(config.marks, state.iteration):
        num_bytes = stream_bytes(export_scene(state, config))
        state.steering = steered(state.steering, math.log(num_bytes / config.weights.size))


def is_time(marks: Marks, iteration: int) -> bool:
    """Whether a run is measured after an iteration: from the middle of the rate's growing part on."""
    start = (marks.context_start + max(marks.growth_end, marks.context_start)) // 2
    done = iteration - start
    return done > 0 and done % max((marks.iterations - start) // TIMES, 1) == 0


def steered(before: Steering, miss: float) -> Steering:
    """What to do about a size.

    Args:
        before: What was done last, and what was missing then.
        miss: Logarithm of the size over the wanted one.
    """
    change = INTEGRAL * miss + PROPORTIONAL * (miss - (miss if before.miss is None else before.miss))
    return Steering(min(max(before.log_rate + change, -FURTHEST), FURTHEST), miss)


def stream_bytes(scene: AnchorScene) -> int:
    """Bytes of a scene's stream in the default packetization, everything counted."""
    return len(stream_to_bytes(encode_anchors(scene)))
