"""Files of anchor scenes: one safetensors file per scene, validated strictly and written atomically.

The only metadata entry, `splatwire`, is a JSON object: format, version, kind, voxel size as a hexadecimal float, model
(only for the causal model), configuration, slopes of the leaky ReLUs, and whether the scene has hints; where present,
background, origin, metadata, a mask of the received attributes (`erasures`), and names of sections for concealment. The
signs of the hash grid are packed into bits.
"""

from pathlib import Path
from typing import Any

import numpy as np

from splatwire.anchors._coding_file import coding_header, coding_networks, coding_tensors, read_coding, read_config
from splatwire.anchors._scene_reader import SceneReader, open_scene_file
from splatwire.anchors.tensor_file import write_tensors
from splatwire.arguments import checked
from splatwire.errors import BitstreamError, check_kind
from splatwire.types import AnchorLayout, Anchors, Attribute, LossMask
from splatwire.types.anchor_scene import AnchorScene, GaussianHeads
from splatwire.types.background import BLACK
from splatwire.types.metadata import NO_METADATA, metadata_from_json, metadata_to_json
from splatwire.types.networks import Mlp
from splatwire.types.origin import NO_ORIGIN
from splatwire.types.prior import AttributePrior, Prior
from splatwire.types.received_scene import PredictedPositions, ReceivedScene, TierSizes
from splatwire.types.scene import RenderHints, Scene

FORMAT = "splatwire-scene"
VERSION = 1
SCENE, PARTIAL = "scene", "partial"
_HEADS = ("opacity", "covariance", "color")
_ATTRIBUTES = ("feature", "scaling", "offset")


def save_scene(scene: Scene, path: Path, *, loss_mask: LossMask | None = None) -> None:
    """Writes a scene file atomically; equal scenes give equal bytes.

    Args:
        scene: The scene. Its results of loss concealment (`hints`) are written, too.
        path: Path of the file; its folder must exist.
        loss_mask: Mask of the received attributes, for information; None if the scene was never transmitted.

    Raises:
        InvalidValueError: If `scene` is not a scene of anchors.
        OSError: If the file cannot be written.
    """
    check_kind(scene, AnchorScene, "open_scene")
    assert isinstance(scene, AnchorScene)
    tensors, header = _scene_tensors(scene), _header(scene, SCENE)
    if loss_mask is not None:
        tensors["erasures.received"], header["erasures"] = loss_mask.received, True
    write_tensors(tensors, header, path)


@checked
def load_scene(path: Path) -> AnchorScene:
    """Reads the file of a complete scene.

    Args:
        path: The file.

    Returns:
        The scene, with numpy arrays.

    Raises:
        UnsupportedVersionError: If this release does not support the file's version.
        BitstreamError: If the file is absent, damaged, not a scene file or contains a scene with losses.
    """
    scene, loss_mask = load_scene_file(path)
    if isinstance(scene, AnchorScene):
        return scene
    if loss_mask is not None and loss_mask.num_lost:
        raise BitstreamError(
            f"{path}: {loss_mask.num_lost:,} of the scene's {scene.scene.anchors.num_anchors:,} anchors were lost; "
            "conceal it first: `splatwire decode --conceal NAME`"
        )
    return scene.scene


@checked
def load_scene_file(path: Path) -> tuple[AnchorScene | ReceivedScene[AnchorScene], LossMask | None]:
    """Reads a scene file, complete or with losses.

    Args:
        path: The file.

    Returns:
        The scene, and the mask of received attributes; the mask is None for a scene that was never transmitted.

    Raises:
        UnsupportedVersionError: If this release does not support the file's version.
        BitstreamError: If the file is not a scene file, or is damaged.
    """
    with open_scene_file(path, FORMAT, VERSION, None) as reader:
        if reader.header["kind"] == SCENE:
            return _read_complete(reader)
        if reader.header["kind"] != PARTIAL:
            raise reader.error(f"holds a {str(reader.header['kind'])[:40]!r}, which this release does not know")
        received = _read_partial(reader)
    return received, received.loss_mask


def save_partial(received: ReceivedScene[AnchorScene], path: Path) -> None:
    """Writes a received scene with losses, its loss mask, and the side information for loss concealment.

    Raises:
        OSError: If the file cannot be written.
    """
    tensors = _scene_tensors(received.scene)
    tensors["erasures.received"] = received.loss_mask.received
    prior, predicted = received[Prior], received.get(PredictedPositions)
    tensors["prior.context"] = prior.context_features
    if predicted is not None:
        tensors["anchors.guessed"] = predicted.positions
    if received.tier_sizes is not None:
        tensors["anchors.tier_sizes"] = received.tier_sizes
    for name in _ATTRIBUTES:
        attribute: AttributePrior = getattr(prior, name)
        for part in ("mean", "scale", "step"):
            tensors[f"prior.{name}.{part}"] = getattr(attribute, part)
    header = _header(received.scene, PARTIAL)
    for name, content in received.sections.items():
        tensors[f"concealment.{name}"] = np.frombuffer(content, dtype=np.uint8)
    if received.sections:
        header["concealment"] = sorted(received.sections)
    write_tensors(tensors, header, path)


@checked
def load_partial(path: Path) -> ReceivedScene[AnchorScene]:
    """Reads a received scene with losses, written by `save_partial`.

    Raises:
        UnsupportedVersionError: If this release does not support the file's version.
        BitstreamError: If the file is not a scene file, is damaged, or contains a complete scene.
    """
    with open_scene_file(path, FORMAT, VERSION, PARTIAL) as reader:
        return _read_partial(reader)


def _read_partial(reader: SceneReader) -> ReceivedScene[AnchorScene]:
    scene = _read_scene(reader)
    count, layout = scene.anchors.num_anchors, scene.coding.config.layout
    received = reader.tensor("erasures.received", (count, len(Attribute)), np.bool_)
    attributes = {}
    for name, channels in zip(_ATTRIBUTES, (layout.feature_dim, 6, 3 * layout.num_offsets), strict=True):
        attributes[name] = AttributePrior(
            mean=reader.tensor(f"prior.{name}.mean", (count, channels)),
            scale=reader.tensor(f"prior.{name}.scale", (count, channels)),
            step=reader.tensor(f"prior.{name}.step", (count, 1)),
        )
    context = reader.tensor("prior.context", (count, scene.coding.config.context_dim))
    concealment = _read_concealment_sections(reader)
    records: list[Any] = [Prior(**attributes, context_features=context), layout]
    if reader.has("anchors.guessed"):
        records.append(PredictedPositions(reader.tensor("anchors.guessed", (count, 3))))
    records += _read_tier_sizes(reader, count)
    reader.finish()
    return ReceivedScene(scene, LossMask(received), concealment, tuple(records))


def _read_tier_sizes(reader: SceneReader, count: int) -> list[TierSizes]:
    name = "anchors.tier_sizes"
    if not reader.has(name):
        return []
    sizes = reader.tensor(name, (count,))
    if not bool((sizes > 0).all()):
        raise reader.error(f"tensor '{name}' has a size that is not above 0")
    return [TierSizes(sizes)]


def _read_concealment_sections(reader: SceneReader) -> dict[str, bytes]:
    names = reader.header.get("concealment", [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise reader.error("the header's list of what was left for concealers is damaged")
    sizes = {name: reader.length(f"concealment.{name}") for name in names}
    return {n: reader.tensor(f"concealment.{n}", (size,), np.uint8).tobytes() for n, size in sizes.items()}


def _networks(scene: AnchorScene) -> dict[str, Mlp]:
    return {f"heads.{name}": getattr(scene.heads, name) for name in _HEADS} | coding_networks(scene.coding)


def _header(scene: AnchorScene, kind: str) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "kind": kind,
        "voxel_size": float(scene.coding.voxel_size).hex(),
        **coding_header(scene.coding),
        "negative_slopes": {name: network.negative_slope for name, network in _networks(scene).items()},
        "hints": scene.hints is not None,
        **({} if scene.background == BLACK else {"background": list(scene.background)}),
        **({} if scene.origin == NO_ORIGIN else {"origin": list(scene.origin)}),
        **({} if scene.metadata == NO_METADATA else {"metadata": metadata_to_json(scene.metadata)}),
    }


def _scene_tensors(scene: AnchorScene) -> dict[str, Any]:
    tensors = {f"anchors.{name}": value for name, value in vars(scene.anchors).items()}
    for prefix, network in _networks(scene).items():
        for layer in ("hidden", "output"):
            for part in ("weight", "bias"):
                tensors[f"{prefix}.{layer}.{part}"] = getattr(getattr(network, layer), part)
    tensors |= coding_tensors(scene.coding)
    if scene.hints is not None:
        tensors["hints.size_gain"], tensors["hints.left_out"] = scene.hints.size_gain, scene.hints.left_out
        if scene.hints.opacity_gain is not None:
            tensors["hints.opacity_gain"] = scene.hints.opacity_gain
    return tensors


def _read_complete(reader: SceneReader) -> tuple[AnchorScene, LossMask | None]:
    scene, loss_mask = _read_scene(reader), None
    if reader.header.get("erasures"):
        shape = (scene.anchors.num_anchors, len(Attribute))
        loss_mask = LossMask(reader.tensor("erasures.received", shape, np.bool_))
    reader.finish()
    return scene, loss_mask


def _read_scene(reader: SceneReader) -> AnchorScene:
    config = read_config(reader)
    layout = config.layout
    anchors = _read_anchors(reader, layout)
    voxel_size = reader.voxel_size(anchors.positions)
    head_inputs = layout.feature_dim + 4
    head_outputs = (layout.num_offsets, 7 * layout.num_offsets, 3 * layout.num_offsets)
    heads = GaussianHeads(
        *(reader.network(f"heads.{n}", head_inputs, out) for n, out in zip(_HEADS, head_outputs, strict=True))
    )
    coding = read_coding(reader, config, voxel_size)
    hints = None
    if reader.header.get("hints"):
        count = anchors.num_anchors
        left_out = reader.tensor("hints.left_out", (count,), np.bool_)
        opacity_gain = reader.tensor("hints.opacity_gain", (count,)) if reader.has("hints.opacity_gain") else None
        hints = RenderHints(reader.tensor("hints.size_gain", (count,)), left_out, opacity_gain)
    metadata = metadata_from_json(reader.header.get("metadata"), reader.path)
    return AnchorScene(anchors, heads, coding, hints, reader.background(), reader.origin(), metadata)


def _read_anchors(reader: SceneReader, layout: AnchorLayout) -> Anchors:
    count = reader.length("anchors.positions")
    return Anchors(
        positions=reader.tensor("anchors.positions", (count, 3)),
        features=reader.tensor("anchors.features", (count, layout.feature_dim)),
        scalings=reader.tensor("anchors.scalings", (count, 6)),
        offsets=reader.tensor("anchors.offsets", (count, layout.num_offsets, 3)),
        mask=reader.tensor("anchors.mask", (count, layout.num_offsets), np.bool_),
    )
