"""`splatwire export`: a scene becomes a file that other programs open."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from splatwire.cli._files import input_path, prepared_output
from splatwire.cli._output import JsonFlag, Reporter, print_json, print_summary, progress_bars
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.data import Dataset
    from splatwire.model import AnchorScene
    from splatwire.scene import Cameras
    from splatwire.scene.splats import Splats


@dataclass(frozen=True)
class Export:
    """Export a scene as explicit Gaussians, which common splat viewers open; the loss of quality is measured."""

    kind: tyro.conf.Positional[Literal["ply", "compressed-ply", "spz", "sog", "splat"]]
    """ply is the format of 3DGS; compressed-ply, spz and sog are smaller; splat has 32 bytes per Gaussian
    and one colour for all directions."""
    scene: tyro.conf.Positional[str]
    """Scene file, decoded scene with gaps, or stream; - for standard input. Explicit Gaussians are converted."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """File to write."""
    data: Annotated[Path | None, tyro.conf.arg(aliases=["-s"])] = None
    """Dataset folder: fitted to its training views, measured on its test views and photos."""
    cameras: Path | None = None
    """Cameras file whose views are fitted to and measured on, instead of a dataset."""
    views: int = 64
    """Without --data and --cameras: views on a sphere around the scene, of which every eighth only measures."""
    degree: int = 3
    """Degree of the spherical harmonics, 0 to 3."""
    conceal: str = "drop"
    """Concealer for a scene with gaps."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.conceal import create_concealer
        from splatwire.evaluate.scenes import drawable_scene
        from splatwire.exporters import FitCounts
        from splatwire.model import AnchorScene
        from splatwire.ops.spherical_harmonics import num_functions

        num_functions(self.degree)
        concealer = create_concealer(self.conceal)
        if str(self.output) == "-":
            raise InvalidValueError("an export is read back to be measured: give -o a file")
        prepared_output(self.output, suffix=f".{self.kind.removeprefix('compressed-')}")
        with input_path(self.scene) as source:
            scene, num_lost = drawable_scene(source, concealer)
        started, counts, measured = time.perf_counter(), FitCounts(), None
        with progress_bars() as show:
            if isinstance(scene, AnchorScene):
                measured = self._fit(scene, counts, show)
            else:
                counts.possible = counts.written = self._write(iter([scene.drawn()]))
        result = {
            "output": str(self.output),
            "num_gaussians": counts.written,
            "num_bytes": self.output.stat().st_size,
            "degree": self._degree if isinstance(scene, AnchorScene) else min(scene.splats.degree, self._degree),
            "left_out": {"unseen": counts.unseen, "faint": counts.faint},
            "num_lost": num_lost,
            "seconds": time.perf_counter() - started,
            "measured": measured,
        }
        if self.json:
            print_json(result)
        else:
            print_summary(_sentence(result))

    @property
    def _degree(self) -> int:
        return self.degree if self.kind != "splat" else 0

    def _write(self, parts: "Iterator[Splats]") -> int:
        from splatwire.formats.kinds import WRITERS

        return WRITERS[self.kind.replace("-", ".")](parts, self.output)

    def _fit(self, scene: "AnchorScene", counts: Any, show: Reporter) -> dict[str, Any]:
        from splatwire.exporters import fit_splats
        from splatwire.formats.kinds import READERS
        from splatwire.render import create_renderer

        fitted_to, measured_on, photos = self._views(scene)
        draw = create_renderer("cpu")
        parts = fit_splats(scene, fitted_to, draw, degree=self._degree, counts=counts, progress=show)
        self._write(parts)
        splats = READERS[self.kind.removeprefix("compressed-")](self.output)
        return measure(scene, splats, measured_on, photos, show)

    def _views(self, scene: "AnchorScene") -> "tuple[Cameras, Cameras, Dataset | None]":
        """Views to fit to, views to measure on, and photos of the latter."""
        from splatwire.data import load_cameras, open_dataset
        from splatwire.render.importance import surrounding_cameras

        if self.data is not None and self.cameras is not None:
            raise InvalidValueError("give either --data FOLDER or --cameras FILE")
        if self.data is not None:
            test = open_dataset(self.data, split="test", background=scene.background)
            return open_dataset(self.data, split="train").cameras, test.cameras, test
        if self.cameras is not None:
            cameras = load_cameras(self.cameras)
            return cameras, cameras, None
        if self.views < 9:
            raise InvalidValueError(f"--views must be 9 or more, not {self.views}")
        cameras = surrounding_cameras(scene, self.views)
        held_out = [view for view in range(self.views) if view % 8 == 4]
        return cameras.select([v for v in range(self.views) if v not in held_out]), cameras.select(held_out), None


def measure(
    scene: "AnchorScene", splats: "Splats", cameras: "Cameras", photos: "Dataset | None", show: Reporter
) -> dict[str, Any]:
    """Compares pictures of explicit Gaussians with those of the scene that they were fitted to, and with photos.

    Args:
        scene: The scene.
        splats: The Gaussians.
        cameras: Where both are looked at from.
        photos: Photos from there, if there are any.
        show: Progress.

    Returns:
        Means over the views: PSNR of the two pictures to each other and, where there are photos, of both to them.
    """
    import torch

    from splatwire.metrics import psnr
    from splatwire.model import SplatScene
    from splatwire.render import iterate_views

    background = torch.tensor(scene.background)
    rows = []
    shown = (scene, SplatScene(splats))
    pairs = zip(*(iterate_views(what, cameras, background=background) for what in shown), strict=True)
    for view, (neural, explicit) in enumerate(pairs):
        row = [float(psnr(explicit[None], neural[None])[0])]
        if photos is not None:
            photo, mask = photos.image(view)[None], photos.mask(view)
            masks = None if mask is None else mask[None]
            row += [float(psnr(picture[None], photo, masks)[0]) for picture in (neural, explicit)]
        rows.append(row)
        show("measuring", (view + 1) / cameras.num_views)
    means = torch.tensor(rows, dtype=torch.float64).mean(dim=0).tolist()
    result: dict[str, Any] = {"num_views": cameras.num_views, "psnr_to_scene": means[0]}
    if photos is not None:
        result |= {"psnr_scene": means[1], "psnr_export": means[2], "psnr_loss": means[1] - means[2]}
    return result


def _sentence(result: dict[str, Any]) -> str:
    text = f"{result['num_gaussians']:,} Gaussians, {result['num_bytes']:,} bytes -> {result['output']}"
    measured = result["measured"]
    if measured is None:
        return text
    quality = f"PSNR to the scene's own pictures {measured['psnr_to_scene']:.2f} dB"
    if "psnr_loss" in measured:
        quality = (
            f"test PSNR {measured['psnr_export']:.2f} dB instead of {measured['psnr_scene']:.2f} dB "
            f"(loss {measured['psnr_loss']:.2f} dB), {quality}"
        )
    return f"{text}; {quality} over {measured['num_views']} views"
