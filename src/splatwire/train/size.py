"""A size that the stream of a scene is to have: lambda is steered by what the real coder makes of the scene."""

import math
from collections.abc import Callable
from dataclasses import replace

from splatwire.codec import encode_scene
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
HEADROOM, LAST = 0.12, 0.007
"""How far above the size, relative to it, a run is held when it is measured first, and at its end, since the last fit
takes so much. A scene that has become too small hardly grows again: what lambda took is not there to be improved."""
FURTHEST = math.log(64)
"""Lambda stays within this of the recipe's."""
CODED = 6
"""Where sizes can be estimated, every this many measurements the scene is coded, and the others are corrected by it.
Coding 270,000 anchors takes seconds, in which a GPU does hundreds of iterations."""


def steer(state: TrainState, config: TrainConfig, estimate: Callable[[TrainState], float] | None = None) -> None:
    """Changes lambda where it is time to, so that the stream comes out at the size that the recipe asks for.

    Args:
        state: After an iteration; its steering is replaced.
        config: The recipe.
        estimate: Estimates the bytes of a stream, up to a factor; None to code every time.

    Raises:
        InvalidValueError: If no anchor is left.
    """
    if config.weights.size and is_time(config.marks, state.iteration):
        aim = config.weights.size * (1 + headroom(config.marks, state.iteration))
        size, ratio = _measured(state, config, estimate)
        state.steering = replace(steered(state.steering, math.log(size / aim)), ratio=ratio)


def _measured(
    state: TrainState, config: TrainConfig, estimate: Callable[[TrainState], float] | None
) -> tuple[float, float | None]:
    """Bytes of a state's stream, and their ratio to the estimate."""
    if estimate is None:
        return float(stream_bytes(export_scene(state, config))), None
    estimated, ratio = estimate(state), state.steering.ratio
    if ratio is None or measurements(config.marks, state.iteration) % CODED == 0:
        ratio = stream_bytes(export_scene(state, config)) / estimated
    return estimated * ratio, ratio


def first_measured(marks: Marks) -> int:
    """Iteration after which a run is measured: in the middle of growing with the rate on."""
    return (marks.context_start + max(marks.growth_end, marks.context_start)) // 2


def is_time(marks: Marks, iteration: int) -> bool:
    """Whether a run is measured after an iteration."""
    since = iteration - first_measured(marks)
    return since > 0 and since % _interval(marks) == 0


def measurements(marks: Marks, iteration: int) -> int:
    """Measurements after an iteration, that of the iteration itself included."""
    return max(iteration - first_measured(marks), 0) // _interval(marks)


def _interval(marks: Marks) -> int:
    return max((marks.iterations - first_measured(marks)) // TIMES, 1)


def headroom(marks: Marks, iteration: int) -> float:
    """How far above the size a run is held after an iteration, relative to it."""
    left = (marks.iterations - iteration) / max(marks.iterations - first_measured(marks), 1)
    return LAST + (HEADROOM - LAST) * left


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
    return len(stream_to_bytes(encode_scene(scene)))
