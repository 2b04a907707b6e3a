"""Scene to stream."""

import hashlib
from collections.abc import Callable

import numpy as np

from splatwire.codec.atomic import Symbols, chunks, encode_packets, predict_packets
from splatwire.codec.coding_params import CodingContext, quantise
from splatwire.codec.digest import update_digest
from splatwire.codec.fit import fit_side_info
from splatwire.codec.geometry import anchor_order
from splatwire.codec.side_info import read_side_info, write_side_info
from splatwire.codec.threads import threads_for
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene
from splatwire.model.voxels import voxel_indices
from splatwire.packets import PRESETS, Packet, Packetization, PacketPlan, SceneStream, make_stream
from splatwire.version import __version__

MAX_SYMBOL = (1 << 31) - 1


def encode_scene(
    scene: AnchorScene,
    packetization: Packetization | None = None,
    *,
    noise: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> SceneStream:
    """Encodes a scene into independently decodable packets (paper 3.2).

    Anchors without a single existing offset draw nothing and are not coded, as in HAC++ (HACPP_SPEC 2).

    Args:
        scene: The scene; its render hints are not coded.
        packetization: How anchors are split; None for preset `paper`.
        noise: Tolerated noise of the context networks (`splatwire.codec.fit`); None for the measured rule.
        progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        The complete stream.

    Raises:
        InvalidValueError: If there is nothing to encode, or values are not finite or too large.
    """
    packetization = packetization or PRESETS["paper"]
    if packetization.packaging != "atomic":
        raise InvalidValueError(f"packaging '{packetization.packaging}' is not implemented by the encoder")
    scene = scene_in_order(scene, packetization.order)
    with threads_for(scene.anchors.num_anchors):
        return _encode(scene, packetization, noise, progress)


def _encode(
    scene: AnchorScene, packetization: Packetization, noise: float | None, progress: Callable[[float], None] | None
) -> SceneStream:
    source = SymbolSource(scene)
    side_info = write_side_info(fit_side_info(scene, _voxels(scene), noise=noise))
    # Predict from what a decoder will read, not from what was meant.
    info = read_side_info(side_info, scene.anchors.num_anchors, packetization.order)
    plan = PacketPlan(packetization, scene.anchors.num_anchors)
    context, groups, digest = info.coding_context(), plan.groups(), hashlib.sha256()
    counts = np.diff(groups.starts)
    payloads: list[bytes] = []
    for run in chunks(counts):
        ranks = groups.ranks[groups.starts[run.start] : groups.starts[run.stop]]
        predicted = predict_packets(context, context.predict(info.voxels[ranks])[1])
        symbols = source.symbols(ranks, predicted.factors, context)
        payloads += encode_packets(context, predicted, counts[run], symbols, info.mask_models())
        update_digest(digest, symbols)
        if progress:
            progress(run.stop / len(counts))
    packets = [Packet(i, int(n), p) for i, n, p in zip(plan.ids, counts, payloads, strict=True)]
    layout = scene.config.layout
    return make_stream(
        packetization=packetization, num_anchors=plan.num_anchors, feature_dim=layout.feature_dim,
        num_offsets=layout.num_offsets, feature_groups=layout.feature_groups, side_info=side_info, packets=packets,
        symbols_digest=digest.hexdigest(), writer=f"splatwire {__version__}",
    )  # fmt: skip


def scene_in_order(scene: AnchorScene, order: str) -> AnchorScene:
    """The scene's drawable anchors, sorted by rank.

    Args:
        scene: The scene.
        order: As in `Packetization.order`.

    Returns:
        The scene with the anchors that have at least one offset, render hints left out.

    Raises:
        InvalidValueError: If no anchor is left.
    """
    drawable = scene.anchors.mask.any(dim=1).nonzero()[:, 0]
    if not len(drawable):
        raise InvalidValueError("the scene has no anchor that draws anything: there is nothing to encode")
    anchors = scene.anchors.select(drawable)
    index = anchor_order(voxel_indices(anchors.positions, scene.voxel_size).numpy(), order)
    anchors = anchors.select(drawable.new_tensor(index))
    return AnchorScene(anchors, scene.heads, scene.context, scene.voxel_size, scene.config)


class SymbolSource:
    """Quantises a scene's attributes with the steps that the coding context gives.

    Args:
        scene: The scene, anchors by rank.
    """

    def __init__(self, scene: AnchorScene) -> None:
        anchors = scene.anchors
        self._mask = anchors.mask.numpy()
        self._values = (
            anchors.features.numpy(),
            anchors.scalings.numpy(),
            (anchors.offsets * anchors.mask[:, :, None]).flatten(1).numpy(),
        )
        for name, values in zip(("features", "scalings", "offsets"), self._values, strict=True):
            if not np.isfinite(values).all():
                raise InvalidValueError(f"the scene's {name} are not all finite")

    def symbols(self, ranks: np.ndarray, factors: np.ndarray, context: CodingContext) -> Symbols:
        """Symbols of the anchors at `ranks` under step factors int64 (n, 3)."""
        parts = []
        for a, values in enumerate(self._values):
            base = context.config.base_steps[a]
            if np.abs(values[ranks]).max(initial=0) / (base * factors[:, a].min() / 65536) > MAX_SYMBOL:
                raise InvalidValueError("an attribute is too large for its quantisation step")
            parts.append(quantise(values[ranks], factors[:, a], base))
        return Symbols(self._mask[ranks].astype(np.uint8), *parts)


def _voxels(scene: AnchorScene) -> np.ndarray:
    return voxel_indices(scene.anchors.positions, scene.voxel_size).numpy()
