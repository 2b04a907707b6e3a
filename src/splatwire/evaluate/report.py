"""The report: one HTML file with every picture, chart and number in it, and nothing fetched from elsewhere."""

import base64
import io
import json
import math
import os
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import splatwire
from splatwire.evaluate.charts import bytes_by_part, psnr_by_view
from splatwire.evaluate.results import Evaluation, Picture

REPORT_NAME = "report.html"
RESULTS_NAME = "results.json"
ERROR_GAIN = 4


def write_report(
    evaluation: Evaluation,
    folder: Path,
    *,
    title: str,
    notes: tuple[str, ...] = (),
    extra: Mapping[str, Any] | None = None,
) -> Path:
    """Writes `report.html`, `results.json` and the pictures as PNG files.

    Args:
        evaluation: What to report.
        folder: Where to; made if it is not there. Files of the same names are replaced.
        title: Headline.
        notes: Paragraphs on what was done.
        extra: Further entries of `results.json`.

    Returns:
        The path of the HTML file.

    Raises:
        OSError: If the disk refuses.
    """
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    for view, pixels in evaluation.references.items():
        _save_png(pixels, folder / "pictures" / f"{_safe(evaluation.view_names[view])}_reference.png")
    for picture in evaluation.pictures:
        name = f"{_safe(evaluation.view_names[picture.view])}_{_safe(picture.method)}.png"
        _save_png(picture.pixels, folder / "pictures" / name)
    for losses in evaluation.loss_maps:
        name = f"{_safe(evaluation.view_names[losses.view])}_loss_map_{_safe(losses.stream)}.png"
        _save_png(losses.pixels, folder / "pictures" / name)
    results = {**(extra or {}), **evaluation.to_json()}
    _write(folder / RESULTS_NAME, json.dumps(results, indent=1, allow_nan=False) + "\n")
    _write(folder / REPORT_NAME, render_report(evaluation, title=title, notes=notes))
    return folder / REPORT_NAME


def render_report(evaluation: Evaluation, *, title: str, notes: tuple[str, ...] = ()) -> str:
    """Renders the HTML text of a report."""
    return render_template(
        "report.html.jinja",
        title=title,
        notes=notes,
        version=splatwire.__version__,
        rows=evaluation.rows(),
        best=_best(evaluation),
        info=evaluation.to_json(),
        lpips_note=evaluation.lpips_note,
        parts=evaluation.stream_parts,
        views=[_view(evaluation, view) for view in evaluation.references],
        loss_maps=[
            {"stream": m.stream, "view": evaluation.view_names[m.view], "image": jpeg(m.pixels)}
            for m in evaluation.loss_maps
        ],
        psnr_chart=psnr_by_view(evaluation),
        bytes_chart=bytes_by_part(evaluation),
        error_gain=ERROR_GAIN,
    )


def render_template(name: str, **values: Any) -> str:
    """Fills one of the templates of this package; `style` is the style that reports share.

    Args:
        name: File name of the template.
        values: What it needs.
    """
    import jinja2

    files = resources.files("splatwire.evaluate")
    style = files.joinpath("report.css").read_text(encoding="utf-8")
    source = files.joinpath(name).read_text(encoding="utf-8")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    return environment.from_string(source).render(style=style, **values)


def _view(evaluation: Evaluation, view: int) -> dict[str, Any]:
    reference = evaluation.references[view]
    shown = [_picture(picture, reference) for picture in evaluation.pictures if picture.view == view]
    return {"name": evaluation.view_names[view], "reference": jpeg(reference), "pictures": shown}


def _picture(picture: Picture, reference: np.ndarray) -> dict[str, Any]:
    heat = error_map(picture.pixels, reference)
    text = f"{picture.psnr:.2f} dB" if math.isfinite(picture.psnr) else "equal to the reference"
    return {"method": picture.method, "psnr": text, "image": jpeg(picture.pixels), "error": jpeg(heat, 75)}


def error_map(pixels: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The largest channel difference of every pixel, times `ERROR_GAIN`; uint8, H W."""
    error = np.abs(pixels.astype(np.int16) - reference.astype(np.int16)).max(axis=2)
    return np.clip(error * ERROR_GAIN, 0, 255).astype(np.uint8)


def _best(evaluation: Evaluation) -> str | None:
    """The method with the highest PSNR among those that met losses."""
    lossy = {method.name for method in evaluation.protocol.lossy_methods}
    rows = [row for row in evaluation.rows() if row["method"] in lossy and row["psnr"] is not None]
    return max(rows, key=lambda row: row["psnr"])["method"] if rows else None


def jpeg(pixels: np.ndarray, quality: int = 88) -> str:
    """RGB or grey, uint8, as the address of a JPEG picture that a page carries in itself."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=quality)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def _save_png(pixels: np.ndarray, path: Path) -> None:
    Image.fromarray(pixels).save(path)


def _safe(name: str) -> str:
    """A file name without folders or surprises."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name).lstrip(".")[:80] or "view"


def _write(path: Path, text: str) -> None:
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        unfinished.write_text(text, encoding="utf-8")
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
