"""Implementation of `splatwire export`: converts a scene to a file format of other programs."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from splatwire.anchors.appearance import antialiased, explicit_gaussians, metadata_of, origin_of
from splatwire.anchors.export.counts import FitCounts
from splatwire.anchors.export.fit import fit_splats
from splatwire.cli._files import check_inputs, input_path, prepared_output, refuse_own_input
from splatwire.cli._output import print_json, print_summary, progress_bars
from splatwire.cli._scenes import chosen_outliers
from splatwire.cli.export import Export
from splatwire.concealment import create_concealer
from splatwire.data import Dataset, load_cameras, open_dataset
from splatwire.errors import InvalidValueError
from splatwire.evaluation.exported import compare_export
from splatwire.files.scene_formats import FileFormat
from splatwire.io import drawable_scene, open_scene
from splatwire.io.formats.dispatch import format_named, storable_properties, warn_of_background, write_with
from splatwire.io.formats.outliers import Outliers
from splatwire.io.formats.spz_writer import FULL_BITS
from splatwire.ops.spherical_harmonics import num_functions
from splatwire.render.cpu import each_gradient_cpu
from splatwire.render.importance import surrounding_cameras
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.types import Cameras
from splatwire.types.origin import NO_ORIGIN
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats

_VIEWS = 64
"""Number of views around the scene for fitting Gaussians, and for measuring the export."""


def run(command: Export) -> None:
    """Runs `splatwire export`: writes a scene as explicit Gaussians."""
    num_functions(_degree(command))
    _outliers(command)
    concealer = create_concealer(command.conceal)
    _check(command)
    refuse_own_input(command.output, command.scene)
    with input_path(command.scene) as source:
        scene, num_lost = drawable_scene(source, concealer)
    started, counts, measured = time.perf_counter(), FitCounts(), None
    with progress_bars() as show:
        views = _views(command, scene)
        if views is not None and (command.data is not None or command.cameras is not None):
            warn_of_near_plane(scene, views.measured_on)
        splats = explicit_gaussians(scene)
        if splats is None:
            assert views is not None
            degree = _degree(command)
            parts = fit_splats(scene, views.fitted_to, each_gradient_cpu, degree=degree, counts=counts, progress=show)
            _write(command, parts, scene)
        else:
            degree = min(splats.degree, _degree(command))
            counts.possible = counts.written = _write(command, iter([_limited(command, splats, degree)]), scene)
        if views is not None:
            measured = compare_export(scene, _read_back(command, scene), views.measured_on, views.photos, show)
    result = {
        "output": str(command.output),
        "num_gaussians": counts.written,
        "num_bytes": command.output.stat().st_size,
        "degree": degree,
        "left_out": {"unseen": counts.unseen, "faint": counts.faint},
        "num_lost": num_lost,
        "seconds": time.perf_counter() - started,
        "measured": measured,
    }
    if command.json:
        print_json(result)
    else:
        lost = f"; {num_lost:,} lost {scene.ELEMENTS} were concealed by '{command.conceal}'" if num_lost else ""
        print_summary(f"{_sentence(result)}{lost}")


def _check(command: Export) -> None:
    """Checks the options of the subcommand `export` before any file is read."""
    if str(command.output) == "-":
        raise InvalidValueError("an export is read back to be measured: give -o a file")
    prepared_output(command.output, expected_suffix=Path(f"x{_format(command).suffix}").suffix)
    if command.kind == "splat" and command.degree:
        raise InvalidValueError(f"--degree {command.degree}: a .splat file has one colour for all directions, degree 0")
    if command.harmonic_bits is not None and command.kind != "spz":
        raise InvalidValueError("--harmonic-bits is for spz: other formats have harmonics of one width")
    if command.harmonic_bits is not None and not all(1 <= bits <= 8 for bits in command.harmonic_bits):
        raise InvalidValueError(f"--harmonic-bits takes two numbers from 1 to 8, not {command.harmonic_bits}")
    if command.spz_version is not None and command.kind != "spz":
        raise InvalidValueError("--spz-version is for spz")
    if command.spz_version not in (None, 3, 4):
        raise InvalidValueError(f"--spz-version is 3 or 4, not {command.spz_version}")
    if sum(value is not None for value in (command.data, command.cameras, command.views)) > 1:
        raise InvalidValueError("give either --data FOLDER, --cameras FILE or --views NUMBER")
    check_inputs(command.data, command.cameras)
    if command.views is not None and command.views < 9:
        raise InvalidValueError(f"--views must be 9 or more, not {command.views}")


def _limited(command: Export, splats: Splats, degree: int) -> Splats:
    """Returns Gaussians without spherical harmonics above a degree.

    For the format `.splat`, the Gaussians are returned unchanged: its writer removes all spherical harmonics.

    Args:
        command: Options of `splatwire export`.
        splats: The Gaussians.
        degree: Maximum degree of the spherical harmonics.
    """
    # The writer of `.splat` also reports that.
    return splats if command.kind == "splat" else splats.at_most_degree(degree)


def _degree(command: Export) -> int:
    return command.degree if command.degree is not None else 0 if command.kind == "splat" else 3


def _write(command: Export, parts: Iterator[Splats], scene: Scene) -> int:
    warn_of_background(command.output, scene.background)
    properties = storable_properties(
        _format(command),
        command.output,
        antialiased=antialiased(scene),
        origin=origin_of(scene),
        outliers=_outliers(command),
        metadata=metadata_of(scene),
    )
    if command.kind == "spz":
        properties |= {"harmonic_bits": command.harmonic_bits or FULL_BITS, "version": command.spz_version or 4}
    return write_with(_format(command), parts, command.output, **properties)


def _format(command: Export) -> FileFormat:
    """Returns the file format of the export.

    Raises:
        UnknownNameError: If no writable format has that name.
    """
    return format_named(command.kind.replace("-", "."))


def _outliers(command: Export) -> Outliers:
    return chosen_outliers(command.outliers, f"x{_format(command).suffix}")


def _read_back(command: Export, scene: Scene) -> Scene:
    """Reads the exported file, with positions relative to the origin of the exported scene."""
    written: Any = open_scene(command.output)
    return written if written.origin != NO_ORIGIN else replace(written, origin=origin_of(scene))


def _views(command: Export, scene: Scene) -> "_Views | None":
    """Returns the cameras for fitting and for measuring exported Gaussians; None if not needed."""
    # Neither is needed for explicit Gaussians without options that request a measurement.
    if command.data is not None:
        test = open_dataset(command.data, split="test", background=scene.background)
        return _Views(open_dataset(command.data, split="train").cameras, test.cameras, test)
    if command.cameras is not None:
        cameras = load_cameras(command.cameras)
        return _Views(cameras, cameras)
    if command.views is None and explicit_gaussians(scene) is not None:
        return None
    cameras = surrounding_cameras(scene, command.views or _VIEWS)
    held_out = [view for view in range(cameras.num_views) if view % 8 == 4]
    fitted_to = [view for view in range(cameras.num_views) if view not in held_out]
    return _Views(cameras.select(fitted_to), cameras.select(held_out))


@dataclass(frozen=True)
class _Views:
    fitted_to: Cameras
    measured_on: Cameras
    photos: Dataset | None = None


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
