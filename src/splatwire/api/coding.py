"""Encoding of any scene, with options that depend on the kind of scene, and decoding of any stream."""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splatwire.anchors.appearance import as_scene
from splatwire.arguments import CheckedFields, checked_except
from splatwire.bitstream import Packetization, SceneStream, read_stream, stream_from_bytes
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.gaussians.quality import Quality, quality_of
from splatwire.errors import InvalidValueError, check_progress, shown
from splatwire.rate_control.encoding import Effort, encode_controlled
from splatwire.rate_control.targets import Target, parse_size
from splatwire.rate_control.tuning import Tuning
from splatwire.reprs import summary_repr
from splatwire.sequence import Frame, SequenceOptions, encode_sequence
from splatwire.types import AnchorScene, ReceivedScene, SplatScene
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats

Progress = Callable[[float], None]
_TUNING_SHARE = 0.9
"""Share of fine-tuning in the reported progress of the effort `best`; the rest is the search that follows."""


@dataclass(frozen=True, eq=False)
class GaussianOptions(CheckedFields):
    """Options for encoding explicit Gaussians.

    Attributes:
        packetization: Division into packets, or the name of a preset such as `datagram`; None for the default.
        quality: Quantisation: 0 (smallest) to 100 (finest), `small` (40), `default` (60), `near-lossless` (85), or a
            `Quality`. None for `default`; for a decoded scene without `class_offsets`, None keeps its quantisation
            steps.
        tiers: Importance tier of each Gaussian, 0 for the most important, whole numbers (N); None for one tier.
        class_offsets: Precision class (set of quantisation steps) of each Gaussian, whole numbers (N): 0 for the
            finest, negative for coarser ones, see `splatwire.render.precision`; None for the finest class.
    """

    packetization: Packetization | str | None = None
    quality: str | int | float | Quality | None = None
    tiers: np.ndarray | None = None
    class_offsets: np.ndarray | None = None

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class AnchorOptions(CheckedFields):
    """Options for encoding neural anchors, whose quantisation steps are trained.

    Attributes:
        packetization: Division into packets, or the name of a preset such as `paper`; None for the default.
        tiers: Importance tier of each anchor, 0 for the most important, whole numbers (N); None for one tier.
        network_tolerance: Tolerance for rounding the weights of the context model. Rounding changes the predictions of
            the model. The value is the tolerated change as a share of the predicted standard deviations, such as 0.1
            for a tenth. Larger values give less side information (data that all packets need) and larger packets. None
            for the default.
    """

    packetization: Packetization | str | None = None
    tiers: np.ndarray | None = None
    network_tolerance: float | None = None

    __repr__ = summary_repr


@checked_except("scene", "progress")
def encode(
    scene: Scene | ReceivedScene[Any] | Splats | Iterable[Frame | Splats],
    options: GaussianOptions | AnchorOptions | SequenceOptions | None = None,
    *,
    size: int | str | None = None,
    psnr: float | None = None,
    quality: str | int | float | Quality | None = None,
    effort: Effort | None = None,
    tuning: Tuning | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> SceneStream:
    """Encodes a scene, or the frames of a sequence, into independently decodable packets.

    With `size`, `psnr` or `effort`, the encoder chooses the precision of each Gaussian by rendering the scene;
    `class_offsets` and `tiers` of the options must then be None.

    Args:
        scene: A scene, a decoded scene without losses, explicit Gaussians, or, with `SequenceOptions`, frames.
        options: Options of the kind of scene: `GaussianOptions`, `AnchorOptions`, or `SequenceOptions` for frames. None
            for the defaults.
        size: Explicit Gaussians: maximum size of the stream as one file, bytes, or a text such as `500kB`. The stream
            is usually at most 3 % smaller.
        psnr: Explicit Gaussians: target PSNR against pictures of the source, decibels; usually reached within 0.2 dB.
        quality: Explicit Gaussians and frames: quality setting, instead of `quality` in the options.
        effort: Explicit Gaussians: `fast` keeps all Gaussians. `default` removes the Gaussians that pictures do not
            need. `best` then also fine-tunes the remaining Gaussians, which takes minutes. None for `default` with
            `size` or `psnr`.
        tuning: Options for `best`, such as the seed and a simulated packet loss; None for the defaults.
        threads: Number of threads, which does not affect the result; None for one per processor. Must be None for
            frames (see `SequenceOptions`).
        progress: Called with the completed fraction of the work, 0 to 1. Must be None for frames.

    Returns:
        The complete stream.

    Raises:
        InvalidValueError: If the options are for another kind of scene, a value is out of range, or the target cannot
            be reached.

    Example:
        >>> import splatwire
        >>> scene = splatwire.open_scene("scene.ply")
        >>> stream = splatwire.encode(scene, splatwire.GaussianOptions("datagram", quality="small"))
        >>> len(stream.packets) == stream.manifest.num_packets
        True
    """
    if tuning is not None and effort != "best":
        raise InvalidValueError("tuning is for the effort best: only then Gaussians are fine-tuned")
    if isinstance(options, SequenceOptions):
        if (size, psnr, effort) != (None, None, None):
            raise InvalidValueError("size, psnr and effort are for static scenes: frames take a quality")
        chosen = options if quality is None else replace(options, quality=quality)
        return _encode_frames(scene, chosen, threads, progress)
    if isinstance(scene, list | tuple | Iterator):
        raise InvalidValueError(f"expected a scene, not {shown(scene)}: frames need the options `SequenceOptions`")
    checked_scene = as_scene(scene)  # type: ignore[arg-type]
    expected = AnchorOptions if isinstance(checked_scene, AnchorScene) else GaussianOptions
    if options is not None and not isinstance(options, expected):
        raise InvalidValueError(
            f"options: expected {expected.__name__} for {checked_scene.ELEMENTS}, not {shown(options)}"
        )
    if (size, psnr, quality, effort) == (None, None, None, None):
        fields_given = {} if options is None else vars(options)
        return encode_scene(checked_scene, threads=threads, progress=progress, **fields_given)
    if not isinstance(checked_scene, SplatScene):
        raise InvalidValueError(
            "size, psnr, quality and effort are for explicit Gaussians: anchors have their own steps"
        )
    gaussian_options = GaussianOptions() if options is None else options
    assert isinstance(gaussian_options, GaussianOptions)
    if quality is not None and gaussian_options.quality is not None:
        raise InvalidValueError("give the quality as an argument or in the options, not both")
    gaussian_options = gaussian_options if quality is None else replace(gaussian_options, quality=quality)
    if (size, psnr, effort) == (None, None, None):
        return encode_scene(checked_scene, threads=threads, progress=progress, **vars(gaussian_options))
    return _encode_controlled(checked_scene, gaussian_options, size, psnr, effort, tuning, threads, progress)


def _encode_controlled(
    scene: SplatScene, options: GaussianOptions, size: int | str | None, psnr: float | None, effort: Effort | None,
    tuning: Tuning | None, threads: int | None, progress: Progress | None,
) -> SceneStream:  # fmt: skip
    if options.class_offsets is not None or options.tiers is not None:
        raise InvalidValueError("size, psnr and effort determine precision classes, and leave one tier")
    target = Target(
        size=parse_size(size) if isinstance(size, str) else size,
        psnr=psnr,
        quality=quality_of("default" if options.quality is None else options.quality)
        if (size, psnr) == (None, None) or options.quality is not None
        else None,
    )

    def encode(pruned: SplatScene, class_offsets: np.ndarray, quality: Quality) -> SceneStream:
        return encode_scene(
            pruned, options.packetization, quality=quality, class_offsets=class_offsets, threads=threads
        )

    report, tuning_share, done = progress or (lambda share: None), _TUNING_SHARE if effort == "best" else 0.0, 0.0

    def forward(task: str, share: float) -> None:
        nonlocal done
        completed = {"fine-tuning": tuning_share * share, "searching": tuning_share + (1 - tuning_share) * share}.get(
            task, 0.0
        )
        done = max(done, completed)
        report(done)

    result = encode_controlled(
        scene, target, encode, effort=effort or "default", tuning=tuning or Tuning(), progress=forward
    )
    report(1.0)
    return result.stream


def _encode_frames(
    frames: Any, options: SequenceOptions, threads: int | None, progress: Progress | None
) -> SceneStream:
    if threads is not None or progress is not None:
        raise InvalidValueError("a sequence has its number of threads in SequenceOptions, and no progress")
    return encode_sequence(frames, options)[0]


@checked_except("stream", "progress")
def decode(
    stream: SceneStream | bytes | str | os.PathLike[str],
    *,
    threads: int | None = None,
    progress: Progress | None = None,
) -> ReceivedScene[Scene]:
    """Decodes the received packets of a stream.

    Args:
        stream: A stream, the bytes of a stream file, or the path of a stream.
        threads: Number of threads, which does not affect the result; None for one per processor.
        progress: Called with the completed fraction of the work, 0 to 1.

    Returns:
        The scene with the mask of received elements; `conceal` makes a scene that can be drawn.

    Raises:
        BitstreamError: If the data are not a stream, or a part of the stream contradicts another.
        InvalidValueError: If `stream` has another type.

    Example:
        >>> import splatwire
        >>> received = splatwire.decode("scene.swz")
        >>> received.loss_mask.num_lost
        0
    """
    check_progress(progress)
    if isinstance(stream, bytes):
        stream = stream_from_bytes(stream)[0]
    elif isinstance(stream, str | os.PathLike):
        stream = read_stream(stream)[0]
    return decode_stream(stream, threads=threads, progress=progress)
