"""A scene that can be drawn at any moment of its transfer."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import numpy as np

from splatwire.codec import ProgressiveDecoder
from splatwire.conceal import Concealer
from splatwire.conceal.progressive import ProgressiveConcealer
from splatwire.errors import DesyncError
from splatwire.model import AnchorScene
from splatwire.packets import Manifest, Packet, SceneStream


class ProgressiveScene:
    """What arrived is exact, the rest concealed; late packets replace what was concealed.

    `add` may be called from one thread (or several) while another one draws.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information; from here on there is a scene.
        concealer: A concealer or its name.
        progress: Called with the share of the preparation that is done, 0 to 1.

    Raises:
        BitstreamError: If the side information cannot be read.
        UnknownNameError: No concealer has that name.
    """

    def __init__(
        self,
        manifest: Manifest,
        side_info: bytes,
        concealer: Concealer | str = "grow",
        *,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self._decoder = ProgressiveDecoder(manifest, side_info, progress=progress)
        self._concealer = ProgressiveConcealer(self._decoder.partial, concealer)

    @property
    def num_anchors(self) -> int:
        """Anchors of the complete scene."""
        return self._decoder.manifest.num_anchors

    @property
    def num_known(self) -> int:
        """Anchors that have arrived."""
        return self._decoder.num_known

    @property
    def complete(self) -> bool:
        """Whether everything has arrived."""
        return self._decoder.complete

    @property
    def stream(self) -> SceneStream:
        """What has arrived."""
        return self._decoder.stream

    @property
    def decoder(self) -> ProgressiveDecoder:
        """The decoder underneath, which counts packets."""
        return self._decoder

    @property
    def recomputed(self) -> int:
        """Concealed anchors that were computed so far."""
        return self._concealer.recomputed

    @property
    def incremental(self) -> bool:
        """Whether this concealer's cost is proportional to what changed."""
        return self._concealer.incremental

    def add(self, packets: Iterable[Packet]) -> int:
        """Takes packets in any order; returns how many anchors are new.

        Raises:
            DesyncError: If now everything is there and the decoded integers are not those that were encoded.
        """
        decoder, new = self._decoder, np.empty(0, np.int64)
        try:
            new = decoder.add(packets)
        except DesyncError:
            new = decoder.partial.erasures.known.nonzero()[:, 0].numpy()  # wrong, but there
            raise
        finally:
            with decoder.lock:
                self._concealer.arrived(new)
        return len(new)

    def conceal_with(self, concealer: Concealer | str) -> None:
        """Changes the concealer, from scratch.

        Raises:
            UnknownNameError: No concealer has that name.
        """
        with self._decoder.lock:
            self._concealer = ProgressiveConcealer(self._decoder.partial, concealer)

    @contextmanager
    def reading(self) -> Iterator[AnchorScene]:
        """Gives the scene as of now; while it is read, arrivals wait. Keep nothing of it."""
        with self._decoder.lock:
            yield self._concealer.scene()
