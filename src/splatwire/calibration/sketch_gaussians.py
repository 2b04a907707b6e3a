"""Coarse copies of the most important Gaussians of a scene (a sketch)."""

# The most important 1 % of the Gaussians cause 60 to 96 % of the error after a packet loss (scenes luigi, tiger,
# guitar, truck), and no concealer can predict them.

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.calibration.sketch_config import SketchConfig
from splatwire.calibration.views import Progress
from splatwire.codec.gaussians.copies import MAX_COPIES, read_copies
from splatwire.codec.gaussians.copies_encoder import write_copies
from splatwire.codec.gaussians.decoder import open_side_info
from splatwire.codec.gaussians.side_info import SideInfo
from splatwire.concealment import Concealed
from splatwire.concealment.scene_free.elements import gaussian_inputs
from splatwire.concealment.sketch.concealer import grown_with_copies, with_copies
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.render.pruning import removal_errors
from splatwire.types import Cameras, ReceivedScene, SplatScene
from splatwire.types.splats import Splats

LEVEL = 1
"""Precision class of the copies. With the same number of bytes, more copies are better than more precise copies: on
luigi, with a sketch of 3 % of the stream, the classes 1 / 3 / 5 give 37.46 / 37.44 / 37.17 dB."""

_BYTES_OF_COPY = 10
"""Approximate bytes of a copy; determines the first guess in the search for the number of copies."""
_CLOSE = 0.98
"""The search for the number of copies ends when the sketch has at least this share of the maximum size."""


@dataclass(frozen=True, eq=False)
class GaussianSketch:
    """Sketch: coarse copies of a scene's most important Gaussians, drawn if the Gaussians themselves are lost.

    A receiver also enlarges received Gaussians, to cover lost ones that have no copy. A neural network may correct the
    enlargement.

    Attributes:
        splats: All Gaussians of the stream, in the order of the decoded scene.
        indices: Indices in `splats` of the Gaussians that have a copy, int64.
        info: The stream's side information.
        growth: Three parameters of the enlargement: exponent for the size, exponent for the opacity, and weight of the
            network's correction, 0 (no correction) to 1.
        growth_candidates: Pairs of exponents (size, opacity) that the calibration tries, the default first.
        trust_candidates: Weights of the network's correction that the calibration tries, the default first.
    """

    splats: Splats
    indices: np.ndarray
    info: SideInfo
    growth: tuple[float, ...]
    growth_candidates: ClassVar = ((0.125, 0.75), (0.0, 0.0), (0.0, 0.5), (0.0, 1.0), (0.125, 1.25), (0.25, 0.75))
    trust_candidates: ClassVar = (0.5, 0.0, 1.0)

    @staticmethod
    def fitted(
        stream: SceneStream,
        complete: ReceivedScene[SplatScene],
        cameras: Cameras,
        max_bytes: int,
        config: SketchConfig,
        show: Progress,
    ) -> "GaussianSketch":
        """Creates the sketch of a scene: copies as many Gaussians as fit into `max_bytes` bytes, most important first.

        Args:
            stream: The complete stream.
            complete: The decoded scene.
            cameras: Views in which the importance of Gaussians is measured.
            max_bytes: Maximum size of the sketch in bytes.
            config: Settings of the calibration.
            show: Called with the name of the current task and its completed share, 0 to 1.

        Raises:
            InvalidValueError: If the sketch is too small for a single copy, no element is visible in any view, or the
                stream's codec does not support sketches.
        """
        scene = complete.scene
        try:
            info = open_side_info(stream.manifest, stream.side_info)
        except BitstreamError as error:  # Gaussians of another schema
            raise InvalidValueError(f"a stream of {stream.manifest.elements} has no redundant copies") from error
        removal = removal_errors(
            scene, cameras, probes=config.probes, seed=config.seed,
            progress=lambda share: show("measuring importance", share),
        )  # fmt: skip
        if not float(removal.sum()) > 0:
            raise InvalidValueError("no view shows anything of the scene: there is nothing to calibrate on")
        ranked = np.argsort(-removal, kind="stable")
        usual = (*GaussianSketch.growth_candidates[0], GaussianSketch.trust_candidates[0])
        everything = GaussianSketch(scene.splats, ranked, info, usual)
        count = _as_many_as_fit(
            lambda count: len(replace(everything, indices=ranked[:count]).section()), len(ranked), max_bytes
        )
        return replace(everything, indices=ranked[:count])

    @property
    def num_sketched(self) -> int:
        """Number of Gaussians that have a coarse copy in the sketch."""
        return len(self.indices)

    def with_growth(self, growth: tuple[float, ...]) -> "GaussianSketch":
        """Returns a sketch with the same coarse copies and new parameters for the enlargement of received Gaussians.

        Args:
            growth: New value of the attribute `growth`.
        """
        return replace(self, growth=growth)

    def section(self) -> bytes:
        """Encodes the coarse copies of the most important Gaussians as the section `sketch` of a stream."""
        size, opacity, trust = self.growth
        return write_copies(self.splats, self.indices, self.info, precision_class=LEVEL, growth=(size, opacity, trust))

    def replace_lost(self, received: ReceivedScene[SplatScene]) -> tuple[ReceivedScene[SplatScene], Any]:
        """Replaces the lost Gaussians of a received scene by the sketch's coarse copies.

        Args:
            received: The received scene.

        Returns:
            The scene with copies, and the inputs of the neural network that predicts how much to enlarge elements
            around the gaps. Pass this pair to `conceal`.
        """
        copies = read_copies(replace(self.info, sections={"sketch": self.section()}), self.splats.num_gaussians)
        assert copies is not None
        received_scene = with_copies(received, copies)
        return received_scene, gaussian_inputs(received_scene)

    def conceal(self, sketched: tuple[ReceivedScene[SplatScene], Any]) -> tuple[ReceivedScene[SplatScene], Concealed]:
        """Enlarges Gaussians to cover lost ones that have no coarse copy, as a receiver of this sketch would.

        A Gaussian counts as lost only if it was not received and has no copy. These lost Gaussians are hidden. All
        other Gaussians are drawn, and those next to lost Gaussians are enlarged.

        Args:
            sketched: Result of the method `replace_lost`: the received scene, with coarse copies in place of lost
                Gaussians; and the inputs of the network that corrects the enlargement.

        Returns:
            The scene with coarse copies; and the result of the concealment, which contains the factors that enlarge
            Gaussians and the mask of the hidden Gaussians.
        """
        received_scene, inputs = sketched
        size, opacity, trust = self.growth
        return received_scene, grown_with_copies(received_scene, inputs, (size, opacity, trust))


def _as_many_as_fit(size: Callable[[int], int], max_copies: int, limit: int) -> int:
    """Returns approximately the largest number of copies whose encoded size does not exceed a limit.

    Args:
        size: Function that returns the encoded size in bytes of a given number of copies.
        max_copies: Maximum number of copies.
        limit: Maximum size in bytes.

    Raises:
        InvalidValueError: If not even one copy fits.
    """
    # The result always fits.
    low, high, tried = 0, min(max_copies, MAX_COPIES) + 1, round(limit / _BYTES_OF_COPY)
    while high - low > 1:
        tried = min(max(tried, low + 1), high - 1)
        num_bytes = size(tried)
        low, high = (tried, high) if num_bytes <= limit else (low, tried)
        if _CLOSE * limit < num_bytes <= limit:
            break
        tried = int(tried * 0.99 * limit / num_bytes)
    if not low:
        raise InvalidValueError(f"no sketch fits into {limit:,.0f} bytes: give it a larger share of the stream")
    return low
