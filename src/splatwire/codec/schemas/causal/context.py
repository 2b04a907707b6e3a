"""The causal model in integers: from places and decoded numbers to the table indices that the entropy coder sees.

Everything is integer arithmetic (matrix products are carried in float64, whose mantissa holds every partial sum
exactly), and an anchor's numbers depend on its own place and its own numbers before, and on nothing else.
`tests/reference/causal_packets.py` says the same in plain torch.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from splatwire.codec.fixed_point import ACTIVATION_BITS
from splatwire.codec.integer_network import IntegerMlp
from splatwire.codec.schemas.causal.side_info import LOG_BITS, SideInfo
from splatwire.entropy.tables import exp2_table
from splatwire.model.causal import OCTAVES, CausalConfig

ONE = 1 << ACTIVATION_BITS
NUMBER_BITS = 16
"""Fractional bits of an anchor's numbers, in steps."""
LARGEST = (1 << 30) - (1 << 26)
"""Numbers stay within this, 15,360 steps."""
EXP2_CELLS = 10
"""The table of powers of two has 2**10 cells for an octave, with linear interpolation."""
EXP2_BITS = 40


@dataclass(frozen=True)
class Stage:
    """Numbers of an anchor that are predicted together.

    Attributes:
        name: Their network.
        first: Column of the first of them.
        size: How many there are.
        masks: Outputs in front of means and spreads: logits of the offsets' existence.
    """

    name: str
    first: int
    size: int
    masks: int = 0


def stages(config: CausalConfig) -> tuple[Stage, ...]:
    """The stages of an anchor in the order of coding; numbers are features, four logarithms, and offsets."""
    found, first = [], 0
    for group, size in enumerate(config.layout.feature_groups):
        found.append(Stage(f"feature{group}", first, size))
        first += size
    return (
        *found,
        Stage("form", first, 1, config.layout.num_offsets),
        Stage("size", first + 1, 3),
        Stage("offset", first + 4, 3 * config.layout.num_offsets),
    )


@dataclass(frozen=True, eq=False)
class CodingContext:
    """What both ends of a stream predict from.

    Attributes:
        config: Shape of the model.
        middle: int64 (3), middle of the scene, voxels.
        spread: int64 (3), extent of the scene, voxels.
        networks: Networks by name.
        chances: int64, of the bits of places, see `SharedPlaces`.
    """

    config: CausalConfig
    middle: np.ndarray
    spread: np.ndarray
    networks: dict[str, IntegerMlp]
    chances: np.ndarray

    @staticmethod
    def of(info: SideInfo) -> "CodingContext":
        """The part of side information that packets are predicted from, in integers."""
        networks = {name: network.integer() for name, network in info.networks.items()}
        return CodingContext(info.config, info.middle, info.spread, networks, info.places.chances)

    @functools.cached_property
    def stages(self) -> tuple[Stage, ...]:
        """See `stages`."""
        return stages(self.config)

    def start(self, voxels: np.ndarray) -> "Chain":
        """Evaluates the position network for anchors at voxels int64 (n, 3)."""
        return Chain(self, self.networks["position"](place_activations(voxels, self.middle, self.spread)))


class Chain:
    """Anchors on their way through the stages: what is known of them so far, as inputs of networks.

    Args:
        context: The context.
        place: int32 (n, context), outputs of the position network.
    """

    def __init__(self, context: CodingContext, place: np.ndarray) -> None:
        from splatwire.codec import _network_kernels as kernels

        config = context.config
        self._context = context
        self._known = np.empty((len(place), config.context_dim + config.layout.feature_dim + 4))
        self.place = np.empty((len(place), config.context_dim))
        kernels.narrow(place, self.place)
        self._known[:, : config.context_dim] = self.place

    def outputs(self) -> Iterator[tuple[Stage, np.ndarray]]:
        """Yields each stage with its network's outputs, int32; its numbers have to be told before the next one."""
        for stage in self._context.stages:
            network = self._context.networks[stage.name]
            yield stage, network(self._known[:, : self._context.config.context_dim + stage.first])

    def tell(self, stage: Stage, numbers: np.ndarray) -> None:
        """Takes the numbers of a stage, int32 (n, size), as known; offsets, the last ones, are no inputs."""
        from splatwire.codec.schemas.causal import _kernels as kernels

        first = self._context.config.context_dim + stage.first
        if first < self._known.shape[1]:
            kernels.activate(numbers, self._known[:, first : first + stage.size])


def place_activations(voxels: np.ndarray, middle: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Inputs of the position network: contracted coordinates, and triangle waves of them, each twice as fast.

    Args:
        voxels: int64 (n, 3).
        middle: int64 (3).
        spread: int64 (3), positive.

    Returns:
        float64 (n, 3 (1 + octaves)) whole numbers, `ACTIVATION_BITS` fractional bits.
    """
    away = np.clip(voxels - middle, -(1 << 40), 1 << 40)
    relative = (away << ACTIVATION_BITS) // spread
    contracted = (np.clip(relative, -(1 << 40), 1 << 40) << ACTIVATION_BITS) // (ONE + np.abs(relative))
    waves = [contracted]
    for octave in range(1, OCTAVES + 1):
        waves.append(np.abs((((contracted << octave) - ONE) & (4 * ONE - 1)) - 2 * ONE) - ONE)
    return np.concatenate(waves, axis=1).astype(np.float64)


def scale_indices(spreads: np.ndarray) -> np.ndarray:
    """Entries of the scale table for binary logarithms of standard deviations in steps, int16.

    Args:
        spreads: int32, `OUTPUT_BITS` fractional bits.
    """
    from splatwire.codec.schemas.causal import _kernels as kernels

    indices = np.empty(spreads.shape, dtype=np.int16)
    kernels.scale_indices(spreads, exp2_table(8, 20), indices)
    return indices


def linear_values(numbers: np.ndarray, step: float | np.ndarray) -> np.ndarray:
    """Values of features or offsets: one rounding to float64 and one to float32.

    Args:
        numbers: int32 (n, D), `NUMBER_BITS` fractional bits.
        step: Their quantisation step or steps.
    """
    return (numbers.astype(np.float64) * (step * 2.0**-NUMBER_BITS)).astype(np.float32)


def form_logs(numbers: np.ndarray, info: SideInfo) -> np.ndarray:
    """Binary logarithms of scale and size, int64 (n, 4) with `LOG_BITS` fractional bits.

    Args:
        numbers: int32 (n, 4), steps.
        info: Where steps and centres are.
    """
    step = info.log_steps[[0, 1, 1, 1]]
    return ((numbers.astype(np.int64) * step) >> NUMBER_BITS) + info.centres


def exponential(logs: np.ndarray) -> np.ndarray:
    """Two to the power of logarithms, float32; alike on every machine.

    Args:
        logs: int64, `LOG_BITS` fractional bits; clipped to 2**-60 to 2**60.
    """
    logs = np.clip(logs, -60 << LOG_BITS, 60 << LOG_BITS)
    whole, rest = logs >> LOG_BITS, logs & ((1 << LOG_BITS) - 1)
    table, shift = exp2_table(EXP2_CELLS, EXP2_BITS), LOG_BITS - EXP2_CELLS
    cell, fraction = rest >> shift, rest & ((1 << shift) - 1)
    mantissa = table[cell] + (((table[cell + 1] - table[cell]) * fraction) >> shift)
    return np.ldexp(mantissa.astype(np.float64), (whole - EXP2_BITS).astype(np.int32)).astype(np.float32)
