"""Rate control in training, so that the stream reaches a target size."""

import math
from collections.abc import Callable
from dataclasses import replace

from splatwire.bitstream import stream_to_bytes
from splatwire.codec import encode_scene
from splatwire.neural.training.config import Milestones, TrainConfig
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.state import SizeController, TrainState
from splatwire.types import AnchorScene

NUM_MEASUREMENTS = 30
"""Number of size measurements during a training."""
PROPORTIONAL, INTEGRAL = 2.0, 0.7
"""Gains of the controller of log lambda: for the change of the size error, and for the size error, both logarithmic.

The size is about inversely proportional to the square root of lambda, with a delay of a few hundred of 2,400
iterations. With these gains the size approaches the target without oscillation."""
INITIAL_EXCESS, FINAL_EXCESS = 0.12, 0.007
"""Allowed excess over the target size, as a share of the target, at the first measurement and at the end of training.

The excess at the end leaves room for the bytes that the final refinement saves. The excess at the start is larger
because a scene that has become too small hardly grows again: removed anchors cannot be improved any more."""
MAX_LOG_LAMBDA_CHANGE = math.log(64)
"""Maximum absolute change of the natural logarithm of lambda from the configured value."""
MEASUREMENTS_PER_ENCODING = 6
"""Number of size measurements per real encoding, if sizes can be estimated.

The other measurements are estimates, corrected by the ratio of encoded to estimated size at the last real encoding.
Encoding 270,000 anchors takes seconds, as long as hundreds of iterations on a GPU."""


def control_size(state: TrainState, config: TrainConfig, estimate: Callable[[TrainState], float] | None = None) -> None:
    """Adjusts lambda, the weight of the rate in the loss, so that the stream approaches the target size.

    Does nothing without a target size, or if no measurement of the size is due in this iteration.

    Args:
        state: State of the training after an iteration; the field `size_controller` is replaced.
        config: The configuration.
        estimate: Function that estimates the bytes of the stream quickly. The estimates may be wrong by a constant
            factor, which is measured by encoding the scene from time to time. None to encode the scene for every
            measurement.

    Raises:
        InvalidValueError: If no anchor is left.
    """
    if config.weights.target_bytes and is_measurement_due(config.milestones, state.iteration):
        max_bytes = config.weights.target_bytes * (1 + allowed_excess(config.milestones, state.iteration))
        size, ratio = _measure_size(state, config, estimate)
        controller = next_controller_state(state.size_controller, math.log(size / max_bytes))
        state.size_controller = replace(controller, ratio=ratio)


def _measure_size(
    state: TrainState, config: TrainConfig, estimate: Callable[[TrainState], float] | None
) -> tuple[float, float | None]:
    """Measures the size that the stream would have if the training ended now, bytes.

    Args:
        state: State of the training.
        config: The configuration.
        estimate: Function that estimates the size; None to encode the scene instead.

    Returns:
        Size in bytes, and the ratio of encoded to estimated size; the ratio is None if `estimate` is None.
    """
    # Encoding is expensive, so with `estimate` the scene is encoded only every few measurements. The other
    # measurements scale the estimate by the last ratio of encoded to estimated size.
    if estimate is None:
        return float(stream_bytes(export_scene(state, config))), None
    estimated, ratio = estimate(state), state.size_controller.ratio
    if ratio is None or num_measurements(config.milestones, state.iteration) % MEASUREMENTS_PER_ENCODING == 0:
        ratio = stream_bytes(export_scene(state, config)) / estimated
    return estimated * ratio, ratio


def measuring_start(milestones: Milestones) -> int:
    """Returns the iteration after which the size of the stream is measured at regular intervals."""
    # Midway between the start of the context phase and the end of the phase in which anchors are added and removed.
    return (milestones.context_start + max(milestones.growth_end, milestones.context_start)) // 2


def is_measurement_due(milestones: Milestones, iteration: int) -> bool:
    """True if the size of the stream is measured after the given training iteration."""
    since = iteration - measuring_start(milestones)
    return since > 0 and since % _interval(milestones) == 0


def num_measurements(milestones: Milestones, iteration: int) -> int:
    """Returns the number of measurements of the stream's size from the start of the training up to an iteration.

    Args:
        milestones: Schedule of the training.
        iteration: The iteration.
    """
    return max(iteration - measuring_start(milestones), 0) // _interval(milestones)


def _interval(milestones: Milestones) -> int:
    return max((milestones.iterations - measuring_start(milestones)) // NUM_MEASUREMENTS, 1)


def allowed_excess(milestones: Milestones, iteration: int) -> float:
    """Returns by how much the stream may exceed the target size after an iteration, as a share of the target size."""
    # The share falls linearly during the training, from `INITIAL_EXCESS` to `FINAL_EXCESS`.
    left = (milestones.iterations - iteration) / max(milestones.iterations - measuring_start(milestones), 1)
    return FINAL_EXCESS + (INITIAL_EXCESS - FINAL_EXCESS) * left


def next_controller_state(before: SizeController, log_error: float) -> SizeController:
    """Returns the state of the size controller after a measurement of the stream's size.

    The field `log_lambda_factor` of the state adjusts lambda, the weight of the bit rate in the loss.

    Args:
        before: State of the size controller before the measurement.
        log_error: Natural logarithm of the ratio of measured size to allowed size. The allowed size is the target size
            plus the excess that is allowed so far.
    """
    change = INTEGRAL * log_error + PROPORTIONAL * (
        log_error - (log_error if before.log_error is None else before.log_error)
    )
    log_lambda_factor = min(max(before.log_lambda_factor + change, -MAX_LOG_LAMBDA_CHANGE), MAX_LOG_LAMBDA_CHANGE)
    return replace(before, log_lambda_factor=log_lambda_factor, log_error=log_error)


def stream_bytes(scene: AnchorScene) -> int:
    """Encodes a scene with the default packetization and returns the size of the stream in bytes."""
    return len(stream_to_bytes(encode_scene(scene)))
