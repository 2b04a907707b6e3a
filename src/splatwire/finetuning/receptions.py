"""Simulated packet loss during fine-tuning."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool

from splatwire.channel.transmit import datagrams_of, draw_in_order
from splatwire.codec.gaussians.packets import PacketDivision
from splatwire.concealment import Grow
from splatwire.finetuning.latents import Gradients
from splatwire.finetuning.options import FineTuning
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

_GROW = Grow()
_MAX_OPAQUE = 0.999


@dataclass(frozen=True, eq=False)
class SimulatedReception:
    """Simulated packet loss of a training iteration: received Gaussians, and the factors that enlarge them.

    The receiver's concealer `grow` makes the received Gaussians larger and more opaque, so that they cover the gaps.

    Attributes:
        received: Mask of received Gaussians.
        size_gain: Factor on the standard deviations of the received Gaussians.
        exponent: Exponent for the opacities of the received Gaussians: opacity `o` becomes `1 - (1 - o) ** exponent`.
    """

    # The concealer enlarges a Gaussian according to the lost share of the Gaussian's neighbours. Here, the lost
    # share of the whole scene is used for all Gaussians. The two shares are nearly equal, because packets are
    # spread over the scene.

    received: Bool[np.ndarray, "N"]
    size_gain: float
    exponent: float

    @staticmethod
    def from_mask(fully_received: Bool[np.ndarray, "N"]) -> "SimulatedReception":
        """Creates a simulated packet loss after which only the given Gaussians are received.

        All received Gaussians are enlarged by the same factors, which depend on the received share of the whole scene.
        The concealer `grow` uses the received share of each Gaussian's neighbours instead.

        Args:
            fully_received: Mask of the received Gaussians.
        """
        gain = float(_GROW.gain(np.array([fully_received.mean()]), fully_received)[0])
        strength = SplatScene.GROW_STRENGTH
        return SimulatedReception(fully_received, gain**strength.size, gain**strength.opacity)

    def received_splats(self, splats: Splats) -> Splats:
        """Returns the received Gaussians as a receiver draws them: enlarged to cover gaps."""
        received = splats.select(self.received)
        clear = 1 - np.minimum(received.opacities, np.float32(_MAX_OPAQUE))
        opacities = 1 - clear ** np.float32(self.exponent)
        return replace(received, scales=received.scales * np.float32(self.size_gain), opacities=opacities)

    def gradients(self, splats: Splats, received_gradients: Gradients) -> Gradients:
        """Back-propagates gradients from the received Gaussians to all Gaussians; gradients of lost Gaussians are 0.

        Args:
            splats: All Gaussians, including those lost with packets.
            received_gradients: Gradients with respect to the received Gaussians, the result of `received_splats`.
        """
        clear = 1 - np.minimum(splats.opacities[self.received], np.float32(_MAX_OPAQUE))
        slope = np.float32(self.exponent) * clear ** np.float32(self.exponent - 1)
        changed = replace(
            received_gradients,
            scales=received_gradients.scales * np.float32(self.size_gain),
            opacities=received_gradients.opacities * slope,
        )
        whole = {}
        for name, values in vars(changed).items():
            whole[name] = np.zeros((len(self.received), *values.shape[1:]), np.float32)
            whole[name][self.received] = values
        return Gradients(**whole)


def simulate_reception(
    division: PacketDivision, options: FineTuning, rng: np.random.Generator
) -> SimulatedReception | None:
    """Simulates the random packet losses of one training iteration.

    Args:
        division: Division of the scene's Gaussians into packets.
        options: Options with the loss model.
        rng: Random generator.

    Returns:
        The received Gaussians, and the factors by which they are enlarged. None if all Gaussians or no Gaussians are
        received; the iteration then uses all Gaussians.
    """
    assert options.packet_loss is not None
    received, _ = draw_in_order(datagrams_of(division.num_bytes), options.packet_loss, int(rng.integers(1 << 62)))
    fully_received = received[division.packet_of_gaussian]
    return None if fully_received.all() or not fully_received.any() else SimulatedReception.from_mask(fully_received)
