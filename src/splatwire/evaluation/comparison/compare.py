"""Scores of several files of one scene: all are rendered from the same views and compared with one reference."""

import logging
import math
import os
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.evaluation.comparison.shots import Shots
from splatwire.evaluation.extent import SceneExtent
from splatwire.evaluation.study.prepared_stream import file_bytes
from splatwire.evaluation.views import ReferenceViews, held_out_cameras, spread
from splatwire.files.kinds import file_kind, opened, trained_ply
from splatwire.files.mmap_array import large_empty
from splatwire.io import open_scene
from splatwire.metrics.lpips import Lpips, find_lpips
from splatwire.render import iterate_views
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.types import Cameras
from splatwire.types.background import Background
from splatwire.types.scene import Scene

LOG = logging.getLogger(__name__)
READS = 2
"""Number of times that a file is read; the shortest time counts, because the first read also loads compiled code."""
MIN_LPIPS_PIXELS = 64
"""Minimum width and height of pictures for LPIPS, pixels."""
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class FileScore:
    """Size, image quality and decoding time of a file.

    Attributes:
        path: The file or folder.
        name: File name or path, as shown in tables.
        format: Identifier of the file format, such as `ply`, `spz` or `stream`.
        num_bytes: Size of the file, or of all files of a folder, bytes.
        num_gaussians: Number of Gaussians; for neural anchors, the maximum number generated from them.
        psnr_by_view: PSNR of each view, decibels; infinite if the picture equals its reference.
        ssim: Mean SSIM of the views.
        lpips: Mean LPIPS of the views; None if not measured.
        seconds: Time to read and decode the file, seconds.
        shots: Pictures for a report; empty if none was requested.
    """

    path: Path
    name: str
    format: str
    num_bytes: int
    num_gaussians: int
    psnr_by_view: tuple[float, ...]
    ssim: float
    lpips: float | None
    seconds: float
    shots: Shots

    @property
    def psnr(self) -> float:
        """Mean PSNR in decibels over the views that differ from the reference; infinite if none differs."""
        finite = [value for value in self.psnr_by_view if math.isfinite(value)]
        return statistics.fmean(finite) if finite else math.inf

    @property
    def exact(self) -> bool:
        """True if the pictures of all views equal the reference."""
        return all(map(math.isinf, self.psnr_by_view))

    @property
    def worst_view(self) -> int:
        """Index of the view with the lowest PSNR."""
        return min(range(len(self.psnr_by_view)), key=self.psnr_by_view.__getitem__)


@dataclass(frozen=True)
class Comparison:
    """Scores of several files of one scene.

    Attributes:
        reference: Path of the file whose renders are the references.
        cameras: The views.
        renderer: Name of the renderer.
        background: RGB behind all renders, 0 to 1.
        lpips: True if LPIPS was computed.
        scores: One score for each file, in the order in which the files were passed.
    """

    reference: Path
    cameras: Cameras
    renderer: str
    background: Background
    lpips: bool
    scores: tuple[FileScore, ...]


def compare_files(
    files: Sequence[Path],
    *,
    reference: Path | None = None,
    cameras: Cameras | None = None,
    views: int | None = None,
    renderer: str = "cpu",
    background: Background | None = None,
    pictures: bool = False,
    progress: Progress = lambda task, share: None,
) -> Comparison:
    """Compares files of one scene with a reference, from the same views and in front of the same background.

    Args:
        files: Files of static scenes in any format that `splatwire.io.open_scene` reads.
        reference: File whose renders are the references; None for the first of `files`.
        cameras: The views; None for generated test views.
        views: Maximum number of views, evenly spread; None for all.
        renderer: Name of the renderer.
        background: RGB behind all renders, 0 to 1; None for the background of the reference.
        pictures: True to keep pictures for a report.
        progress: Called with the name of the current task and its finished share, 0 to 1.

    Raises:
        InvalidValueError: If there is nothing to compare, or a file is a sequence, has no Gaussians, or contains
            another scene.
        BitstreamError: If a file is damaged or has losses.
        DatasetError: If a file of explicit Gaussians is damaged.
    """
    # Besides the reference pictures, only one scene at a time is in memory.
    if len(files) + (reference is not None) < 2:
        raise InvalidValueError("a comparison takes two files or more, or one file and a reference")
    if views is not None and views < 1:
        raise InvalidValueError(f"a comparison takes at least 1 view, not {views}")
    for file in files:
        if not file.exists():
            raise InvalidValueError(f"{file}: no such file or folder")
    chosen, lpips = files[0] if reference is None else reference, find_lpips()
    first = _TimedScene.of(chosen, READS if chosen in files else 1)
    seen = held_out_cameras(first.scene) if cameras is None else cameras
    seen = seen.select(spread(seen.num_views, views))
    warn_of_near_plane(first.scene, seen)
    behind = first.scene.background if background is None else background
    images = large_empty((seen.num_views, seen.height, seen.width, 3), np.float32)
    for view, image in enumerate(iterate_views(first.scene, seen, renderer=renderer, background=behind)):
        images[view] = image
        progress(f"drawing {chosen.name}", (view + 1) / seen.num_views)
    references = ReferenceViews(seen, images.__getitem__, f"renders of {chosen.name}", behind)
    scorer, extent = first.score, SceneExtent.of(first.scene, chosen)
    del first  # large scenes may not fit into memory together
    lpips = lpips if min(seen.width, seen.height) >= MIN_LPIPS_PIXELS else None

    def scored(file: Path, name: str) -> FileScore:
        if file == chosen:
            return _with_metrics(replace(scorer, name=name), references, images, lpips, pictures, progress)
        opened = _TimedScene.of(file, READS)
        other = SceneExtent.of(opened.scene, file)
        if (why := extent.difference(other)) is not None:
            raise InvalidValueError(why)
        if (why := extent.drawing_difference(other)) is not None:
            LOG.warning("%s", why)
        drawn = iterate_views(opened.scene, seen, renderer=renderer, background=behind)
        return _with_metrics(replace(opened.score, name=name), references, drawn, lpips, pictures, progress)

    scores = tuple(scored(file, name) for file, name in zip(files, _names(files), strict=True))
    return Comparison(chosen, seen, renderer, behind, lpips is not None, scores)


def _with_metrics(
    score: FileScore, references: ReferenceViews, drawn: Iterable[np.ndarray], lpips: Lpips | None, pictures: bool,
    progress: Progress,
) -> FileScore:  # fmt: skip
    """Measures the image quality of a scene file, and adds the results to the file's score.

    Args:
        score: Score of the file without image quality.
        references: Views with their reference images.
        drawn: Rendered image of each view.
        lpips: The LPIPS metric; None to leave it out.
        pictures: True to store pictures for a report.
        progress: Called with the name of the task and its finished share, 0 to 1.
    """
    num_views = references.cameras.num_views
    figures: dict[str, list[float]] = {"psnr": [], "ssim": [], "lpips": []}
    shots = Shots(spread(num_views, Shots.NUM_VIEWS)) if pictures else Shots()
    for view, image in enumerate(drawn):
        both = references.compared(view, image)
        for metric in ("psnr", "ssim"):
            figures[metric].append(both.measure(metric))
        if lpips is not None:
            figures["lpips"].append(float(lpips(both.image, both.reference)[0]))
        if pictures:
            shots.add(view, figures["psnr"][-1], both.image[0], both.reference[0])
        progress(f"comparing {score.name}", (view + 1) / num_views)
    return replace(
        score,
        psnr_by_view=tuple(figures["psnr"]),
        ssim=statistics.fmean(figures["ssim"]),
        lpips=statistics.fmean(figures["lpips"]) if lpips is not None else None,
        shots=shots,
    )


@dataclass(frozen=True, eq=False)
class _TimedScene:
    """A scene read from a file, with the size of the file and its reading time."""

    scene: Scene
    score: FileScore

    @classmethod
    def of(cls, path: Path, reads: int) -> "_TimedScene":
        """Reads a scene several times, and measures the shortest reading time.

        Args:
            path: The file or folder of the scene.
            reads: Number of times that the scene is read, at least 1.
        """
        seconds = math.inf
        with opened(path) as source:
            kind = file_kind(source)
            for number in range(reads):
                started = time.perf_counter()
                scene = open_scene(source)
                seconds = min(seconds, time.perf_counter() - started)
                if number + 1 < reads:
                    del scene  # two copies of a large scene may not fit into memory
        score = FileScore(path, path.name, kind.key, _size(path), scene.num_gaussians, (), 0.0, None, seconds, Shots())
        return cls(scene, score)


def _size(path: Path) -> int:
    """Returns the size of a file or folder in bytes."""
    # For a model folder of 3DGS, that of the PLY that is read.
    return file_bytes((trained_ply(path) if path.is_dir() else None) or path)


def _names(files: Sequence[Path]) -> list[str]:
    names = [file.name for file in files]
    return [name if names.count(name) == 1 else os.fspath(file) for name, file in zip(names, files, strict=True)]
