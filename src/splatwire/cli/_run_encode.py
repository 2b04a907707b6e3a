"""Implementation of `splatwire encode`: encodes a scene file or a folder of frames to a stream."""

import math
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from splatwire.anchors.appearance import metadata_of
from splatwire.bitstream import Packetization, SceneStream, measure_sizes, packetization_named, write_stream
from splatwire.bitstream.limits import UNNAMED_SCHEMA
from splatwire.cli._files import input_path, output_path, refuse_own_input
from splatwire.cli._options import quality_option
from splatwire.cli._output import print_json, print_summary, progress_bars, refuse_options
from splatwire.cli._scenes import chosen_background
from splatwire.cli.encode import Encode
from splatwire.codec import encode_scene, schema_of, with_section
from splatwire.codec.gaussians.quality import Quality, quality_of
from splatwire.codec.initial_view import SECTION as INITIAL_VIEW
from splatwire.codec.initial_view import UP_SECTION, initial_view_section
from splatwire.errors import InvalidValueError
from splatwire.files.kinds import SOG_LEVELS, file_kind
from splatwire.io import open_scene
from splatwire.lod import encode_levels
from splatwire.rate_control.targets import Target, parse_size
from splatwire.render.importance import footprint_importance, surrounding_cameras
from splatwire.render.precision import scene_class_offsets
from splatwire.render.up import estimate_up_axis
from splatwire.sequence.frames import is_sequence
from splatwire.types import Cameras
from splatwire.types.scene import Scene

if TYPE_CHECKING:
    from splatwire.rate_control import EncodedScene, Tuning  # imports renderers, which most scenes are encoded without

_STATIC_OPTIONS = (
    "preset", "block_size", "lanes", "tiers", "keep", "data", "cameras", "refine", "levels", "no_sketch", "size",
    "psnr", "effort", "loss", "seed", "update",
)  # fmt: skip
"""Options that apply only to static scenes."""
_OPTIONS_OF_BASE = (
    "preset", "block_size", "lanes", "tiers", "keep", "refine", "levels", "no_sketch", "up", "quality", "size", "psnr",
    "effort", "loss", "seed", "background", "fps", "group", "frames",
)  # fmt: skip
"""Options that an update takes from the stream that it changes."""
_NO_LEVELS = "--effort best does not make levels of detail yet: use --effort default, or --levels none"


def run(command: Encode) -> None:
    """Runs `splatwire encode`: encodes a scene or a clip into a stream."""
    refuse_own_input(command.output, command.scene, command.update)
    with input_path(command.scene) as source:
        _run(command, source)


def _run(command: Encode, source: Path) -> None:
    is_clip = is_sequence(source)
    if is_clip:
        refuse_options(command, _STATIC_OPTIONS, "is for a still scene, not for a clip")
    if command.update is not None:
        refuse_options(
            command, _OPTIONS_OF_BASE, "cannot be combined with --update: an update keeps what its stream has"
        )
    _check(command)
    if is_clip:
        from splatwire.cli._encoded_sequences import (
            encode_sequence_of,  # still scenes are encoded without its libraries
        )

        encode_sequence_of(command, source)
        return
    if (command.fps, command.group, command.frames) != (None, None, None):
        raise InvalidValueError(
            f"--fps, --group and --frames are for clips: a folder with one file per frame, or a .splatv, which "
            f"{command.scene} is not"
        )
    _encode_scene(command, source)


def _check(command: Encode) -> None:
    """Checks the values of the options of `encode`, and that they can be combined, before the scene is read."""
    if command.no_sketch and not _allows_sketch(command):
        raise InvalidValueError("--no-sketch needs --preset datagram and no levels: only then `encode` adds a sketch")
    # Schema and number of elements are not known yet; the checks of the options depend on neither.
    packetization_of(command, UNNAMED_SCHEMA, 1)
    chosen_background(command.background)
    if not all(0 < share < 1 for share in command.tiers) or sum(command.tiers) >= 1:
        raise InvalidValueError(f"--tiers takes shares above 0 that add up to less than 1, not {command.tiers}")
    if not 0 < command.keep <= 1:
        raise InvalidValueError(f"--keep takes a share above 0 and at most 1, not {command.keep:g}")
    if command.quality is not None:
        quality_of(quality_option(command.quality))
    chosen = [name for name in ("size", "psnr", "quality") if getattr(command, name) is not None]
    if len(chosen) > 1:
        raise InvalidValueError(f"give either --{chosen[0]} or --{chosen[1]}: the first determines the second")
    if command.size is not None:
        parse_size(command.size)
    if command.psnr is not None and not 0 < command.psnr < math.inf:
        raise InvalidValueError(f"--psnr takes decibels above 0, not {command.psnr:g}")
    if command.keep != 1 and _effort(command) != "fast":
        raise InvalidValueError("--keep is for --effort fast: otherwise the encoder chooses the share to keep")
    if command.effort == "best":
        if command.levels == "auto":
            raise InvalidValueError(_NO_LEVELS)
        _tuning(command)
    for name in ("loss", "seed"):
        if getattr(command, name) is not None and command.effort != "best":
            raise InvalidValueError(f"--{name} is for --effort best: only then Gaussians are fine-tuned")


def _tuning(command: Encode) -> "Tuning":
    """Returns the options for the fine-tuning of Gaussians that `encode --effort best` performs.

    Raises:
        InvalidValueError: If the loss model or the seed is not valid.
    """
    unit = "datagram" if command.preset == "datagram" else "pak"
    loss = None if command.loss is None else _optional_steps().parse_loss(command.loss, unit)
    return _optional_steps().Tuning(packet_loss=loss, seed=command.seed or 0)


def _effort(command: Encode) -> str:
    """Returns the value of the option `--effort`, or its default."""
    # By default, Gaussians are pruned if there is a target size or PSNR.
    if command.effort is not None:
        return command.effort
    return "fast" if command.size is None and command.psnr is None else "default"


def _needs_rate_control(command: Encode) -> bool:
    """True if the options set a target size or PSNR, or an effort with which the encoder removes Gaussians."""
    return command.size is not None or command.psnr is not None or _effort(command) != "fast"


def _allows_sketch(command: Encode) -> bool:
    """True with `--preset datagram`, which adds a sketch; False with `--levels auto`, which never has one."""
    return command.preset == "datagram" and command.levels != "auto"


def _encode_scene(command: Encode, source: Path) -> None:
    """Encodes a static scene, writes the stream, and prints the stream's properties."""
    if command.data is not None and command.cameras is not None:
        raise InvalidValueError("give either --cameras FILE or --data FOLDER")
    background, has_views = (
        chosen_background(command.background),
        command.data is not None or command.cameras is not None,
    )
    refine = _optional_steps().refiner(command.refine) if command.refine else None
    scene: Any = open_scene(source)
    with_levels = command.levels == "auto" or (command.levels is None and file_kind(source) == SOG_LEVELS)
    schema = schema_of(scene)
    if with_levels and (command.tiers or not schema.explicit):
        raise InvalidValueError("levels need explicit Gaussians, and replace --tiers")
    if with_levels and command.effort == "best":
        raise InvalidValueError(_NO_LEVELS)
    if command.quality is not None and not schema.explicit:
        raise InvalidValueError(
            "--quality is for explicit Gaussians; a scene of anchors has its own quantisation steps"
        )
    if _needs_rate_control(command) and not schema.explicit:
        raise InvalidValueError(
            f"--size, --psnr and --effort {_effort(command)} are for explicit Gaussians; a scene of anchors has its "
            "own quantisation steps"
        )
    if refine is not None and schema.explicit:
        raise InvalidValueError("--refine fits a context model, which explicit Gaussians do not have")
    scene = scene if background is None else replace(scene, background=background)
    cameras = _optional_steps().cameras_of(command, scene) if has_views else None
    if command.update is not None:
        _optional_steps().encode_update_of(command, scene, cameras)
        return
    with progress_bars() as report, output_path(command.output, expected_suffix=".swz", json=command.json) as path:
        if refine is not None:
            scene = refine(scene, progress=lambda share: report("fitting the context model", share))
        started, kept_psnr = time.perf_counter(), None
        if command.keep != 1:
            pruned = _optional_steps().prune(
                scene, command.keep, cameras, progress=lambda share: report("pruning", share)
            )
            scene, kept_psnr = pruned.scene, pruned.psnr
        up = _up(command, scene, cameras)

        def encode(
            scene_to_encode: Any, class_offsets: Any, quality: str | int | float | Quality | None
        ) -> SceneStream:
            packetization = packetization_of(command, schema.name, int(scene_to_encode.drawable.sum()))
            options: Any = {"class_offsets": class_offsets, "quality": quality}
            options["progress"] = lambda share: report("encoding", share)
            if with_levels:
                stream = encode_levels(scene_to_encode, packetization, **options)
            else:
                tiers = _tiers(command, scene_to_encode, cameras)
                stream = encode_scene(scene_to_encode, packetization, tiers=tiers, **options)
            if cameras is not None:
                stream = with_section(stream, INITIAL_VIEW, initial_view_section(cameras))
            if up:
                stream = with_section(stream, UP_SECTION, up.encode())
            if _allows_sketch(command) and not with_levels and not command.no_sketch:
                stream = _optional_steps().with_quick_sketch(stream, cameras, report)
            return stream

        reached = None
        if _needs_rate_control(command):
            reached = _optional_steps().encode_controlled(
                scene, _target(command), encode, effort=_effort(command), cameras=cameras, tuning=_tuning(command),
                progress=report,
            )  # fmt: skip
            stream = reached.stream
        else:
            report("choosing precision", 0.0)
            choose_class_offsets = partial(scene_class_offsets, scene, cameras, recompute=command.quality is not None)
            # The encoder of levels calls the function while it builds them.
            chosen = choose_class_offsets if with_levels else choose_class_offsets()
            report("choosing precision", 1.0)
            stream = encode(scene, chosen, None if command.quality is None else quality_option(command.quality))
        seconds = time.perf_counter() - started
        write_stream(stream, path)
        if reached is not None:
            report("measuring quality", 0.0)
            _ = reached.psnr
    _print_result(command, stream, seconds, kept_psnr, reached)


def _optional_steps() -> ModuleType:
    """Imports the module with the optional encoding steps, such as pruning."""
    # Deferred, because the libraries of this module take a second to load.
    from splatwire.cli import _encode_extras

    return _encode_extras


def _target(command: Encode) -> Target:
    """Returns the target of the encoder: the requested size, PSNR or quality, or else the default quality."""
    if command.size is not None:
        return Target(size=parse_size(command.size))
    if command.psnr is not None:
        return Target(psnr=command.psnr)
    return Target(quality=quality_of(quality_option(command.quality or "default")))


def _print_result(
    command: Encode, stream: SceneStream, seconds: float, kept_psnr: float | None, reached: "EncodedScene | None"
) -> None:
    if command.json:
        content: dict[str, Any] = {
            "output": command.output,
            "num_bytes": stream.num_bytes,
            "parts": stream.part_sizes(),
            "num_packets": len(stream.packets),
            "num_elements": stream.manifest.num_elements,
            "tiers": measure_sizes(stream).tiers,
            "kept_psnr": kept_psnr,
            "seconds": seconds,
        }
        if reached is not None:
            content["reached"] = {
                "psnr": reached.psnr, "kept": reached.kept, "level": reached.quality.level,
                "classes": reached.quality.classes, "effort": _effort(command), "fine_tuned": reached.fine_tuned,
            }  # fmt: skip
        print_json(content)
    else:
        text = f"{stream.manifest.num_elements:,} {stream.manifest.elements} in {len(stream.packets):,} packets"
        if kept_psnr is not None:
            text = f"{text} ({command.keep:.0%} kept: {kept_psnr:.2f} dB against pictures of all)"
        if reached is not None:
            kept = "kept and fine-tuned" if reached.fine_tuned else "kept"
            text = f"{text} ({reached.kept:.0%} {kept}, level {reached.quality.level:.2f})"
            source = "the source" if kept_psnr is None else "the kept ones"
            text = f"{text}, {reached.psnr:.2f} dB against pictures of {source}"
        print_summary(f"{text}, {stream.num_bytes:,} bytes, {seconds:.1f} s -> {command.output}", command.output)


def _up(command: Encode, scene: Scene, cameras: Cameras | None) -> str | None:
    """Returns the up axis to store in the stream for viewers; None to store no axis.

    A value of `--up` other than `auto` is returned unchanged. For `auto`, the axis is estimated from the scene. With
    `auto`, the result is None in three cases: the scene's metadata has an up axis or a view; there are cameras; or the
    estimate is `-y`, which viewers assume by default.
    """
    if command.up != "auto":
        return command.up
    metadata = metadata_of(scene)
    if metadata.up is not None or metadata.view is not None or cameras is not None:
        return None
    return up if (up := estimate_up_axis(scene)) != "-y" else None


def _tiers(command: Encode, scene: Scene, cameras: Cameras | None) -> np.ndarray | None:
    """Returns the importance tier of each element; None for a single tier.

    Elements that cover a larger area in the views of the cameras are more important. Without cameras, views from a
    sphere around the scene are used.
    """
    if not command.tiers:
        return None

    cameras = surrounding_cameras(scene) if cameras is None else cameras
    return footprint_importance(scene, cameras).tiers(command.tiers, scene.drawable)


def packetization_of(command: Encode, schema: str, num_elements: int) -> Packetization:
    """Returns the packetization (division into packets) that the options of `splatwire encode` select.

    `--block-size` and `--lanes` replace the values of the preset.

    Args:
        command: Options of `splatwire encode`.
        schema: Codec schema of the scene.
        num_elements: Number of elements to encode.

    Raises:
        UnknownNameError: If there is no such preset.
        InvalidValueError: If a number is out of range.
    """
    chosen = command.block_size is not None or command.lanes is not None
    start = packetization_named(command.preset or ("paper" if chosen else None), schema, num_elements)
    block_size = start.block_size if command.block_size is None else command.block_size
    return replace(start, block_size=block_size, lanes=start.lanes if command.lanes is None else command.lanes)
