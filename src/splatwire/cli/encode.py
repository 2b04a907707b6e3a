"""`splatwire encode`: a scene file becomes a stream."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from splatwire.cli._files import input_path, output_path
from splatwire.cli._output import JsonFlag, print_json, print_summary, progress_bars, refuse_options
from splatwire.cli._scenes import BackgroundOption, chosen_background
from splatwire.errors import InvalidValueError
from splatwire.files.kinds import holds_frames

if TYPE_CHECKING:
    import numpy as np

    from splatwire.model.appearance import Scene
    from splatwire.packets import Packetization, SceneStream
    from splatwire.scene import Cameras


_STILL = ("preset", "block_size", "lanes", "tiers", "keep", "data", "cameras", "refine", "levels", "no_sketch")
"""Options that a clip has no use for."""


@dataclass(frozen=True)
class Encode:
    """Encode a scene into a stream of independently decodable packets."""

    scene: tyro.conf.Positional[str]
    """Scene file, or explicit Gaussians: PLY, compressed PLY, SPZ, SOG, .splat, .ksplat, .glb; - for standard input. A
    folder with such a file for each frame becomes a clip, and so does a .splatv."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Stream to write: one file if it ends in .swz (or is -), a folder of packets otherwise."""
    preset: str | None = None
    """Packetization to start from: spread (lanes over the whole scene), paper, datagram or hacpp. If absent spread for
    anchors; paper for Gaussians, and where --block-size or --lanes is given."""
    block_size: int | None = None
    """Most elements of a spatial block."""
    lanes: int | None = None
    """Packets that a block is split into."""
    tiers: tuple[float, ...] = ()
    """Shares of the elements, most important first, that get packets of their own: 0.05, or 0.05 0.15."""
    levels: Literal["auto", "none"] | None = None
    """Whether coarser Gaussians are made that stand for many where they are far away or lost (auto): for scenes larger
    than a view. If absent so for a streamed SOG alone, whose finest level is read."""
    keep: float = 1.0
    """Share of the elements that is kept: 0.6 leaves out the 40 % that no view would miss, and says what that costs."""
    data: Path | None = None
    """Photos whose training cameras say what is important, and the first of them where a page begins; views around the
    scene if not given."""
    cameras: Path | None = None
    """The same, a cameras file."""
    no_sketch: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """With --preset datagram: leave out the copies of what matters most (1 % of the bytes, decoded with --conceal
    sketch), which save two decibels where packets are lost."""
    up: Literal["auto", "y", "-y", "z", "-z"] = "auto"
    """Which axis points up, for pages. auto: as the cameras say; without them -y, as in files of Gaussians, unless
    the scene is clearly brighter from below."""
    refine: int = 0
    """Steps in which the context model is fitted to the scene again before: 600 take a minute or two and save some
    percent of the bytes. `train` does so by itself; a scene that was decoded or imported from HAC++ loses 0.1 dB."""
    quality: str | None = None
    """How finely explicit Gaussians are quantised: small, default or near-lossless."""
    background: BackgroundOption = None
    """RGB from 0 to 1 behind everything, to be recorded in the stream; the scene file's own where absent."""
    fps: float | None = None
    """Of a clip: frames a second; 30 where absent."""
    group: int | None = None
    """Of a clip: frames of a group, 1 to 64, which a lost packet of motion is missing for; 15 where absent."""
    frames: int | None = None
    """Of a .splatv: frames that its time is cut into; 50 where absent."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        if holds_frames(Path(self.scene)):  # refused before the codec is loaded, which takes its time
            refuse_options(self, _STILL, "is for a still scene, not for a clip")
        from splatwire.clips.frames import is_sequence

        self._check()
        if is_sequence(self.scene):
            self._encode_clip()
            return
        if (self.fps, self.group, self.frames) != (None, None, None):
            raise InvalidValueError(
                f"--fps, --group and --frames are for what moves: a folder with a file a frame, or a .splatv, which "
                f"{self.scene} is not"
            )
        self._encode_scene()

    def _check(self) -> None:
        """Tells a wrong name or number before the scene is read."""
        from splatwire.codec.schemas.gaussians.quality import quality_of
        from splatwire.packets.limits import UNNAMED_SCHEMA

        if self.no_sketch and not self._sketched:
            raise InvalidValueError("--no-sketch leaves out what only --preset datagram makes, and not with levels")
        self.packetization(UNNAMED_SCHEMA, 1)
        chosen_background(self.background)
        if not all(0 < share < 1 for share in self.tiers) or sum(self.tiers) >= 1:
            raise InvalidValueError(f"--tiers takes shares above 0 that add up to less than 1, not {self.tiers}")
        if not 0 < self.keep <= 1:
            raise InvalidValueError(f"--keep takes a share above 0 and at most 1, not {self.keep:g}")
        if self.quality is not None:
            quality_of(self.quality)

    @property
    def _sketched(self) -> bool:
        """Whether the packets are those that get a sketch."""
        return self.preset == "datagram" and self.levels != "auto"

    def _encode_scene(self) -> None:
        """Encodes a scene that stands still."""
        from splatwire.codec import add_concealment, encode_scene, schema_of
        from splatwire.codec.viewpoint import SECTION as VIEWPOINT
        from splatwire.codec.viewpoint import UP_SECTION, viewpoint_section
        from splatwire.packets import write_stream
        from splatwire.packets.limits import SCHEMAS
        from splatwire.scene_io import has_levels, open_scene

        background, refine = chosen_background(self.background), self._refiner()
        with input_path(self.scene) as source, ThreadPoolExecutor(1) as beside:
            reading = beside.submit(open_scene, source)
            # What compiles and what was compiled is loaded while the file is read.
            from splatwire.levels import encode_levels
            from splatwire.render.precision import classes_of

            scene: Any = reading.result()
            levels = self.levels == "auto" or (self.levels is None and has_levels(source))
        schema = SCHEMAS[schema_of(scene).name]
        if levels and (self.tiers or not schema.explicit):
            raise InvalidValueError("levels are for explicit Gaussians, and are tiers themselves")
        if self.quality is not None and not schema.explicit:
            raise InvalidValueError("--quality is for explicit Gaussians; anchors have steps of their own")
        if refine is not None and schema.explicit:
            raise InvalidValueError("--refine fits a context model, which explicit Gaussians do not have")
        scene = scene if background is None else replace(scene, background=background)
        cameras = self._cameras(scene)
        with progress_bars() as report, output_path(self.output, suffix=".swz", json=self.json) as path:
            if refine is not None:
                scene = refine(scene, progress=lambda share: report("fitting the context model", share))
            started, lost = time.perf_counter(), None
            if self.keep != 1:
                from splatwire.render.pruning import thinned

                left = thinned(scene, self.keep, cameras, progress=lambda share: report("what nobody misses", share))
                scene, lost = left.scene, left.psnr
            report("looking at the scene", 0.0)
            look = partial(classes_of, scene, cameras, anew=self.quality is not None)
            packetization = self.packetization(schema.name, int(scene.drawable.sum()))
            options: Any = {"quality": self.quality, "progress": lambda share: report("encoding", share)}
            if levels:
                stream = encode_levels(scene, packetization, classes=look, **options)
            else:
                tiers, classes = self._tiers(scene, cameras), look()
                report("looking at the scene", 1.0)
                stream = encode_scene(scene, packetization, tiers=tiers, classes=classes, **options)
            if cameras is not None:
                stream = add_concealment(stream, VIEWPOINT, viewpoint_section(cameras))
            if up := self._up(scene, cameras):
                stream = add_concealment(stream, UP_SECTION, up.encode())
            if self._sketched and not levels and not self.no_sketch:
                from splatwire.cli._calibration import with_quick_sketch

                stream = with_quick_sketch(stream, cameras, report)
            seconds = time.perf_counter() - started
            write_stream(stream, path)
        self._tell(stream, seconds, lost)

    def _refiner(self) -> "Callable[..., Scene] | None":
        """What fits the context model again; the trainer is not loaded where nothing does.

        Raises:
            InvalidValueError: If there cannot be so many steps.
        """
        if not self.refine:
            return None
        from splatwire.train.config import RefineConfig
        from splatwire.train.refine import refine_context

        return partial(refine_context, config=RefineConfig(steps=self.refine))

    def _encode_clip(self) -> None:
        """Encodes a folder of frames."""
        from splatwire.cli._clips import clip_options, describe_clip, encode_sequence
        from splatwire.packets import write_stream

        refuse_options(self, _STILL, "is for a still scene, not for a clip")
        options = clip_options(self.fps, self.group, self.quality, chosen_background(self.background), self.up)
        with progress_bars() as report, output_path(self.output, suffix=".swz", json=self.json) as path:
            stream, tracking, seconds = encode_sequence(Path(self.scene), self.frames, options, report)
            write_stream(stream, path)
        facts = describe_clip(stream)
        if self.json:
            print_json({"output": self.output, "num_bytes": stream.num_bytes, **facts, "encoding_seconds": seconds})
            return
        how = f"{tracking.share:.1%} matched" if tracking.matched else "rows keep their Gaussians"
        text = f"{facts['frames']} frames of {facts['num_tracks']:,} tracks ({how}), {stream.num_bytes:,} bytes"
        print_summary(f"{text}, {seconds:.1f} s -> {self.output}", self.output)

    def _tell(self, stream: "SceneStream", seconds: float, kept_psnr: float | None) -> None:
        from splatwire.packets import measure_sizes

        if self.json:
            print_json(
                {
                    "output": self.output,
                    "num_bytes": stream.num_bytes,
                    "parts": stream.parts(),
                    "num_packets": len(stream.packets),
                    "num_elements": stream.manifest.num_elements,
                    "tiers": measure_sizes(stream).tiers,
                    "kept_psnr": kept_psnr,
                    "seconds": seconds,
                }
            )
        else:
            text = f"{stream.manifest.num_elements:,} {stream.manifest.elements} in {len(stream.packets):,} packets"
            if kept_psnr is not None:
                text = f"{text} ({self.keep:.0%} kept: {kept_psnr:.2f} dB against pictures of all)"
            print_summary(f"{text}, {stream.num_bytes:,} bytes, {seconds:.1f} s -> {self.output}", self.output)

    def _up(self, scene: "Scene", cameras: "Cameras | None") -> str | None:
        """The axis that pages have up, to be recorded; None where the scene, its view or the default says it."""
        from splatwire.model.appearance import metadata_of
        from splatwire.render.up import up_of

        if self.up != "auto":
            return self.up
        known = metadata_of(scene)
        if known.up is not None or known.view is not None or cameras is not None:
            return None
        return up if (up := up_of(scene)) != "-y" else None

    def _cameras(self, scene: "Scene") -> "Cameras | None":
        """Cameras that the user named, relative to the scene's origin; None if there are none."""
        from splatwire.data import load_cameras, open_dataset
        from splatwire.model.appearance import origin_of

        if self.data is not None and self.cameras is not None:
            raise InvalidValueError("give either --cameras FILE or --data FOLDER")
        if self.cameras is not None:
            return load_cameras(self.cameras).relative_to(origin_of(scene))
        if self.data is None:
            return None
        return open_dataset(self.data, split="train").cameras.relative_to(origin_of(scene))

    def _tiers(self, scene: "Scene", cameras: "Cameras | None") -> "np.ndarray | None":
        """Tier of every element; None if there is one."""
        if not self.tiers:
            return None
        from splatwire.render.importance import footprint_importance, surrounding_cameras

        seen_from = surrounding_cameras(scene) if cameras is None else cameras
        return footprint_importance(scene, seen_from).tiers(self.tiers, scene.drawable)

    def packetization(self, schema: str, num_elements: int) -> "Packetization":
        """The preset with what the user changed.

        Args:
            schema: What codes the scene.
            num_elements: How many of them will be coded.

        Raises:
            UnknownNameError: If there is no such preset.
            InvalidValueError: If a number is out of range.
        """
        from splatwire.packets import packetization_named

        chosen = self.block_size is not None or self.lanes is not None
        start = packetization_named(self.preset or ("paper" if chosen else None), schema, num_elements)
        block_size = start.block_size if self.block_size is None else self.block_size
        return replace(start, block_size=block_size, lanes=start.lanes if self.lanes is None else self.lanes)
