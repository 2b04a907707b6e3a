"""A scene that can be drawn at any moment of its transfer."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.codec import ProgressiveDecoder, progressive_decoder
from splatwire.conceal import Concealer, concealer_names
from splatwire.conceal.progressive import ProgressiveConcealer
from splatwire.errors import DesyncError
from splatwire.model.appearance import Partial, Scene
from splatwire.packets import Manifest, Packet, PacketIntake, SceneStream


class ProgressiveScene:
    """What arrived is exact, the rest concealed; late packets replace what was concealed.

    `add` may be called from one thread (or several) while another one draws.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information; from here on there is a scene.
        concealer: A concealer or its name.
        intake: What its packets passed where they arrived; None lets them pass one here.
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
        intake: PacketIntake | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self._decoder = progressive_decoder(manifest, side_info, intake=intake, progress=progress)
        self._shown: Partial = self._decoder.partial
        self._concealer = ProgressiveConcealer(self._shown, concealer)

    @property
    def positions(self) -> Float[Tensor, "N 3"]:
        """Where the elements are, or are expected to be."""
        return self._shown.scene.positions

    @property
    def concealers(self) -> tuple[str, ...]:
        """Names of the concealers that can work on it."""
        return concealer_names(self._shown.concealment, self._decoder.manifest.elements)

    @property
    def known(self) -> Bool[Tensor, "N"]:
        """Elements that are exact."""
        return self._shown.erasures.known

    @property
    def num_known(self) -> int:
        """Elements that are exact."""
        return int(self.known.sum())

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
        """Concealed elements that were computed so far."""
        return self._concealer.recomputed

    @property
    def incremental(self) -> bool:
        """Whether this concealer's cost is proportional to what changed."""
        return self._concealer.incremental

    def add(self, packets: Iterable[Packet]) -> int:
        """Takes packets in any order; returns how many elements are new.

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
            self._concealer = ProgressiveConcealer(self._shown, concealer)

    def show(self, packets: Iterable[Packet]) -> None:
        """Shows exactly these of the packets that arrived, as if no other had; whatever comes later must be shown, too.

        Args:
            packets: Any of those that were added.
        """
        decoder = self._decoder
        wanted = np.zeros(len(self.known), dtype=np.bool_)
        for packet in packets:
            wanted[decoder.members(packet)] = True
        with decoder.lock:
            if self._shown is decoder.partial:
                self._shown = decoder.snapshot()
                self._concealer = ProgressiveConcealer(self._shown, self._concealer.concealer)
            old, new = decoder.show(self._shown, wanted)
            if len(old):
                self._concealer.restart()
            else:
                self._concealer.arrived(new)

    @contextmanager
    def reading(self) -> Iterator[Scene]:
        """Gives the scene as of now; while it is read, arrivals wait. Keep nothing of it."""
        with self._decoder.lock:
            yield self._concealer.scene()
