"""Copies of the explicit Gaussians that matter most.

The error of a loss is mostly that of few Gaussians: the most important 1 % make 60 to 96 % of it (luigi, tiger, guitar,
truck), and no concealer can guess one of these. Copies of them cost about their share of the stream.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from splatwire.calibrate.sketch_config import SketchConfig
from splatwire.calibrate.views import Progress
from splatwire.codec.schemas.gaussians.copies import MAX_COPIES, read_copies
from splatwire.codec.schemas.gaussians.copies_encoder import write_copies
from splatwire.codec.schemas.gaussians.decoder import open_side_info
from splatwire.codec.schemas.gaussians.side_info import SideInfo
from splatwire.conceal import Concealed
from splatwire.conceal.scene_free.elements import element_inputs
from splatwire.conceal.sketch.concealer import grown_with_copies, with_copies
from splatwire.errors import InvalidValueError
from splatwire.model import Partial, SplatScene
from splatwire.packets import SceneStream
from splatwire.render.pruning import removal_errors
from splatwire.scene import Cameras
from splatwire.scene.splats import Splats

LEVEL = 1
"""Class of precision of the copies. At equal bytes more of them are better than finer ones: luigi, 3 % of the stream,
class 1 / 3 / 5: 37.46 / 37.44 / 37.17 dB."""

_BYTES_OF_COPY = 10
"""About what a copy takes: where the search for their number begins."""
_CLOSE = 0.98
"""Of the bytes that a sketch may take, enough are used from this share on."""


@dataclass(frozen=True, eq=False)
class GaussianSketch:
    """See `splatwire.calibrate.sketch.Sketch`; a growth is exponents of size and opacity and the trust.

    Attributes:
        splats: All Gaussians of the stream, by place.
        places: int64, of which there are copies.
        info: The stream's side information.
        growth: See `Sketch`.
    """

    splats: Splats
    places: np.ndarray
    info: SideInfo
    growth: tuple[float, ...]
    growths: ClassVar = ((0.125, 0.75), (0.0, 0.0), (0.0, 0.5), (0.0, 1.0), (0.125, 1.25), (0.25, 0.75))
    trusts: ClassVar = (0.5, 0.0, 1.0)

    @staticmethod
    def fitted(
        stream: SceneStream,
        complete: Partial[SplatScene],
        cameras: Cameras,
        most: int,
        config: SketchConfig,
        show: Progress,
    ) -> "GaussianSketch":
        """Chooses the copies; see `AnchorSketch.fitted`."""
        scene, info = complete.scene, open_side_info(stream.manifest, stream.side_info)
        removal = removal_errors(
            scene, cameras, probes=config.probes, seed=config.seed,
            progress=lambda share: show("what each Gaussian is worth", share),
        )  # fmt: skip
        if not float(removal.sum()) > 0:
            raise InvalidValueError("no view shows anything of the scene: there is nothing to calibrate on")
        ranked = np.argsort(-removal, kind="stable")
        usual = (*GaussianSketch.growths[0], GaussianSketch.trusts[0])
        everything = GaussianSketch(scene.splats, ranked, info, usual)
        count = _as_many_as_fit(
            lambda count: len(replace(everything, places=ranked[:count]).section()), len(ranked), most
        )
        return replace(everything, places=ranked[:count])

    @property
    def num_sketched(self) -> int:
        """See `Sketch`."""
        return len(self.places)

    def growing(self, growth: tuple[float, ...]) -> "GaussianSketch":
        """See `Sketch`."""
        return replace(self, growth=growth)

    def section(self) -> bytes:
        """See `Sketch`."""
        size, opacity, trust = self.growth
        return write_copies(self.splats, self.places, self.info, level=LEVEL, growth=(size, opacity, trust))

    def around(self, partial: Partial[SplatScene]) -> tuple[Partial[SplatScene], Any]:
        """See `Sketch`."""
        copies = read_copies(replace(self.info, sections={"sketch": self.section()}), self.splats.num_gaussians)
        assert copies is not None
        filled = with_copies(partial, copies)
        return filled, element_inputs(filled)

    def proposal(self, around: tuple[Partial[SplatScene], Any]) -> tuple[Partial[SplatScene], Concealed]:
        """See `Sketch`."""
        filled, inputs = around
        size, opacity, trust = self.growth
        return filled, grown_with_copies(filled, inputs, (size, opacity, trust))


def _as_many_as_fit(size: Callable[[int], int], most: int, limit: int) -> int:
    """About the largest number up to `most` whose size is within the limit, where sizes rise nearly in proportion."""
    low, high, tried = 0, min(most, MAX_COPIES) + 1, round(limit / _BYTES_OF_COPY)
    while high - low > 1:
        tried = min(max(tried, low + 1), high - 1)
        found = size(tried)
        low, high = (tried, high) if found <= limit else (low, tried)
        if _CLOSE * limit < found <= limit:
            break
        tried = int(tried * 0.99 * limit / found)
    if not low:
        raise InvalidValueError(f"no sketch fits into {limit:,.0f} bytes: give it a larger share of the stream")
    return low
