"""`splatwire export`: a scene becomes a file that other programs open."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from splatwire.cli._files import check_inputs, input_path, prepared_output
from splatwire.cli._output import JsonFlag, Reporter, print_json, print_summary, progress_bars, tell_lost_harmonics
from splatwire.cli._scenes import OutliersOption, chosen_outliers
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.data import Dataset
    from splatwire.formats.outliers import Outliers
    from splatwire.model.appearance import Scene
    from splatwire.scene import Cameras
    from splatwire.scene.splats import Splats

_VIEWS = 64
"""Views on a sphere that anchors are fitted to and measured on."""


@dataclass(frozen=True)
class Export:
    """Export a scene as explicit Gaussians, which common splat viewers open; the loss of quality is measured."""

    kind: tyro.conf.Positional[Literal["ply", "compressed-ply", "spz", "sog", "splat", "glb"]]
    """ply is the format of 3DGS; compressed-ply, spz and sog are smaller; splat has 32 bytes per Gaussian
    and one colour for all directions; glb is glTF with KHR_gaussian_splatting."""
    scene: tyro.conf.Positional[str]
    """Scene file, decoded scene with gaps, or stream; - for standard input. Explicit Gaussians are converted."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """File to write."""
    data: Annotated[Path | None, tyro.conf.arg(aliases=["-s"])] = None
    """Dataset folder: anchors are fitted to its training views; its test views and photos measure the export."""
    cameras: Path | None = None
    """Cameras file whose views are fitted to and measured on, instead of a dataset."""
    views: int | None = None
    """Views on a sphere around the scene, of which every eighth only measures, instead of --data and --cameras; 64 for
    anchors where nothing else is given. Gaussians are measured only where --data, --cameras or --views ask for it."""
    degree: int | None = None
    """Highest degree of the spherical harmonics, 0 to 3; 3 where absent, 0 of a .splat, which has no other."""
    harmonic_bits: tuple[int, int] | None = None
    """Bits of an SPZ's harmonics of degree 1, and of those beyond: 8 8 where absent; 5 4, as other programs write them,
    for a smaller file."""
    spz_version: int | None = None
    """Version of an SPZ: 4 where absent; 3 for programs that do not read 4 yet."""
    outliers: OutliersOption = None
    """Gaussians whose far positions or extreme values would cost all others precision in compressed-ply, spz and sog:
    clamp (where absent) moves them to the end of the range of the others, prune leaves them out, keep writes them as
    they are."""
    conceal: str = "drop"
    """Concealer for a scene with gaps."""
    accept_damage: bool = False
    """Exit with status 0 although bytes of the stream are damaged; packets that are only missing need no option."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.conceal import create_concealer
        from splatwire.exporters.counts import FitCounts
        from splatwire.model.appearance import explicit_gaussians
        from splatwire.ops.spherical_harmonics import num_functions
        from splatwire.render.backends import create_differentiable_renderer
        from splatwire.scene_io import drawable_scene

        num_functions(self._degree)
        self._outliers()
        concealer = create_concealer(self.conceal)
        self._check()
        with input_path(self.scene) as source:
            scene, num_lost = drawable_scene(source, concealer)
        started, counts, measured = time.perf_counter(), FitCounts(), None
        with progress_bars() as show:
            views = self._views(scene)
            splats = explicit_gaussians(scene)
            if splats is None:
                from splatwire.exporters.fit import fit_splats

                assert views is not None
                degree = self._degree
                draw = create_differentiable_renderer("cpu")
                parts = fit_splats(scene, views.fitted_to, draw, degree=degree, counts=counts, progress=show)
                self._write(parts, scene)
            else:
                degree = min(splats.degree, self._degree)
                counts.possible = counts.written = self._write(iter([splats.at_most_degree(degree)]), scene)
                tell_lost_harmonics(scene, self.output)
            if views is not None:
                measured = measure(scene, self._written(scene), views.measured_on, views.photos, show)
        result = {
            "output": str(self.output),
            "num_gaussians": counts.written,
            "num_bytes": self.output.stat().st_size,
            "degree": degree,
            "left_out": {"unseen": counts.unseen, "faint": counts.faint},
            "num_lost": num_lost,
            "seconds": time.perf_counter() - started,
            "measured": measured,
        }
        if self.json:
            print_json(result)
        else:
            print_summary(_sentence(result))

    def _check(self) -> None:
        """Refuses what contradicts itself, before any work."""
        if str(self.output) == "-":
            raise InvalidValueError("an export is read back to be measured: give -o a file")
        prepared_output(self.output, suffix=f".{self.kind.removeprefix('compressed-')}")
        if self.kind == "splat" and self.degree:
            raise InvalidValueError(
                f"--degree {self.degree}: a .splat file has one colour for all directions, degree 0"
            )
        if self.harmonic_bits is not None and self.kind != "spz":
            raise InvalidValueError("--harmonic-bits is for spz: other formats have harmonics of one width")
        if self.harmonic_bits is not None and not all(1 <= bits <= 8 for bits in self.harmonic_bits):
            raise InvalidValueError(f"--harmonic-bits takes two numbers from 1 to 8, not {self.harmonic_bits}")
        if self.spz_version is not None and self.kind != "spz":
            raise InvalidValueError("--spz-version is for spz")
        if self.spz_version not in (None, 3, 4):
            raise InvalidValueError(f"--spz-version is 3 or 4, not {self.spz_version}")
        if sum(value is not None for value in (self.data, self.cameras, self.views)) > 1:
            raise InvalidValueError("give either --data FOLDER, --cameras FILE or --views NUMBER")
        check_inputs(self.data, self.cameras)
        if self.views is not None and self.views < 9:
            raise InvalidValueError(f"--views must be 9 or more, not {self.views}")

    @property
    def _degree(self) -> int:
        return self.degree if self.degree is not None else 0 if self.kind == "splat" else 3

    def _write(self, parts: "Iterator[Splats]", scene: "Scene") -> int:
        from splatwire.formats.kinds import WRITERS, stating
        from splatwire.formats.spz_writer import FULL_BITS
        from splatwire.model.appearance import antialiased, metadata_of, origin_of

        writer: Any = stating(
            WRITERS[self.kind.replace("-", ".")],
            self.output,
            antialiased=antialiased(scene),
            origin=origin_of(scene),
            outliers=self._outliers(),
            metadata=metadata_of(scene),
        )
        if self.kind == "spz":
            writer = partial(writer, harmonic_bits=self.harmonic_bits or FULL_BITS, version=self.spz_version or 4)
        return writer(parts, self.output)

    def _outliers(self) -> "Outliers":
        return chosen_outliers(self.outliers, f"x.{self.kind.replace('-', '.')}")

    def _written(self, scene: "Scene") -> "Scene":
        """The Gaussians of the export as they are drawn, relative to the scene's origin."""
        from splatwire.model.appearance import origin_of
        from splatwire.scene.origin import NO_ORIGIN
        from splatwire.scene_io import open_scene

        written: Any = open_scene(self.output)
        return written if written.origin != NO_ORIGIN else replace(written, origin=origin_of(scene))

    def _views(self, scene: "Scene") -> "_Views | None":
        """Where the scene is looked at from; None for Gaussians of which nobody wants it."""
        from splatwire.data import load_cameras, open_dataset
        from splatwire.model.appearance import explicit_gaussians
        from splatwire.render.importance import surrounding_cameras

        if self.data is not None:
            test = open_dataset(self.data, split="test", background=scene.background)
            return _Views(open_dataset(self.data, split="train").cameras, test.cameras, test)
        if self.cameras is not None:
            cameras = load_cameras(self.cameras)
            return _Views(cameras, cameras)
        if self.views is None and explicit_gaussians(scene) is not None:
            return None
        cameras = surrounding_cameras(scene, self.views or _VIEWS)
        held_out = [view for view in range(cameras.num_views) if view % 8 == 4]
        fitted_to = [view for view in range(cameras.num_views) if view not in held_out]
        return _Views(cameras.select(fitted_to), cameras.select(held_out))


@dataclass(frozen=True)
class _Views:
    fitted_to: "Cameras"
    measured_on: "Cameras"
    photos: "Dataset | None" = None


def measure(
    scene: "Scene", written: "Scene", cameras: "Cameras", photos: "Dataset | None", show: Reporter
) -> dict[str, Any]:
    """Compares pictures of an export with those of the scene that it was made of, and with photos.

    Args:
        scene: The scene.
        written: The Gaussians of the export.
        cameras: Where both are looked at from.
        photos: Photos from there, if there are any.
        show: Progress.

    Returns:
        Means over the views: PSNR of the two pictures to each other and, where there are photos, of both to them.
    """
    import numpy as np

    from splatwire.metrics import psnr
    from splatwire.render import iterate_views

    background = np.array(scene.background)
    rows = []
    shown = (scene, written)
    pairs = zip(*(iterate_views(what, cameras, background=background) for what in shown), strict=True)
    for view, (neural, explicit) in enumerate(pairs):
        row = [float(psnr(explicit[None], neural[None])[0])]
        if photos is not None:
            photo, mask = photos.image(view)[None], photos.mask(view)
            masks = None if mask is None else mask[None]
            row += [float(psnr(picture[None], photo, masks)[0]) for picture in (neural, explicit)]
        rows.append(row)
        show("measuring", (view + 1) / cameras.num_views)
    means = np.mean(rows, axis=0).tolist()
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
