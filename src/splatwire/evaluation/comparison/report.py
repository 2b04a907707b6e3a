"""Results of a comparison of files as JSON values, as table cells, and as one self-contained HTML file."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from splatwire.evaluation.comparison.compare import Comparison, FileScore
from splatwire.evaluation.pixels import ERROR_GAIN
from splatwire.evaluation.study.page import filled_page
from splatwire.files.atomic_write import atomic_write

NAME = "report.html"
"""File name of the report within its folder."""


def comparison_content(comparison: Comparison) -> dict[str, Any]:
    """Returns the results of a comparison as dictionaries and lists, for the JSON report."""
    # The PSNR of equal pictures is infinite here; the JSON writer replaces it by null.
    names = comparison.cameras.names
    return {
        "reference": str(comparison.reference),
        "renderer": comparison.renderer,
        "background": list(comparison.background),
        "views": list(names),
        "width": comparison.cameras.width,
        "height": comparison.cameras.height,
        "rows": [
            {
                "file": str(score.path),
                "format": score.format,
                "num_bytes": score.num_bytes,
                "num_gaussians": score.num_gaussians,
                "psnr": score.psnr,
                "ssim": score.ssim,
                "lpips": score.lpips,
                "exact": score.exact,
                "num_equal_views": sum(map(math.isinf, score.psnr_by_view)),
                "worst_psnr": score.psnr_by_view[score.worst_view],
                "worst_view": names[score.worst_view],
                "psnr_by_view": list(score.psnr_by_view),
                "seconds_decode": score.seconds,
            }
            for score in comparison.scores
        ],
    }


def comparison_headings(comparison: Comparison) -> tuple[str, ...]:
    """Returns the column headings of the table of compared files."""
    lpips = ("LPIPS",) if comparison.lpips else ()
    return ("file", "Gaussians", "bytes", "of first", "PSNR dB", "SSIM", *lpips, "decode s")


def comparison_cells(comparison: Comparison) -> list[tuple[str, ...]]:
    """Returns the cell texts of each file, in the order of `comparison_headings`."""
    first = comparison.scores[0].num_bytes
    return [
        (
            score.name,
            f"{score.num_gaussians:,}",
            f"{score.num_bytes:,}",
            f"{score.num_bytes / first:.3f}",
            "equal" if score.exact else f"{score.psnr:.2f}",
            f"{score.ssim:.4f}",
            *(() if score.lpips is None else (f"{score.lpips:.4f}",)),
            f"{score.seconds:.3f}",
        )
        for score in comparison.scores
    ]


def write_comparison_report(comparison: Comparison, folder: Path) -> Path:
    """Writes the report of a comparison as an HTML page.

    Args:
        comparison: The comparison, made with pictures for a report.
        folder: Folder for the report; created if it does not exist.

    Returns:
        Path of the page.
    """
    cameras, scores = comparison.cameras, comparison.scores
    page = filled_page(
        "splatwire.evaluation.comparison", "report.html.jinja",
        title=f"{len(scores)} files compared with {comparison.reference.name}",
        subtitle=f"{cameras.num_views} views of {cameras.width} x {cameras.height} pixels, {comparison.renderer}",
        columns=comparison_headings(comparison), rows=comparison_cells(comparison), gain=ERROR_GAIN,
        views=[_view(scores, number, cameras.names) for number in range(len(scores[0].shots.kept))],
        worst=[_pictures(score, score.shots.worst, cameras.names) for score in scores if not score.exact],
    )  # fmt: skip
    atomic_write(folder / NAME, page.encode(errors="backslashreplace"), parents=True)
    return folder / NAME


def _view(scores: Sequence[FileScore], number: int, names: Sequence[str]) -> dict[str, Any]:
    """Returns the pictures of all compared files from one view, which the report shows side by side.

    Args:
        scores: Scores of the files, with pictures.
        number: Index of the view in the list of stored pictures (`shots.kept`).
        names: Names of all evaluated views.
    """
    shots = [score.shots.kept[number] for score in scores]
    pairs = zip(scores, shots, strict=True)
    return {
        "name": names[shots[0].view],
        "reference": shots[0].reference,
        "files": [_pictures(score, shot, names) for score, shot in pairs],
    }


def _pictures(score: FileScore, shot: Any, names: Sequence[str]) -> dict[str, Any]:
    psnr = f"{shot.psnr:.2f} dB" if math.isfinite(shot.psnr) else "equal to the reference"
    return {"name": score.name, "view": names[shot.view], "psnr": psnr, "shot": shot}
