"""Result table of `splatwire demo` and `splatwire evaluate`."""

from collections.abc import Mapping, Sequence
from typing import Any

from splatwire.cli._output import print_table
from splatwire.metrics.registry import METRICS


def print_rows(rows: Sequence[Mapping[str, Any]], title: str, *, lpips_note: str) -> None:
    """Prints evaluation results as a table on standard output.

    Args:
        rows: Table rows as returned by `Evaluation.rows`.
        title: Headline.
        lpips_note: Reason for missing LPIPS values, or the views that LPIPS covers.
    """
    best = max((row["psnr"] for row in rows if row["num_lost"] and row["psnr"] is not None), default=None)
    others = list(rows[0]["metrics"]) if rows else []
    headings = ("method", "PSNR dB", "SSIM", "LPIPS", *(METRICS[name].label for name in others))
    lines = [_line(row, others) for row in rows]
    marked = [n for n, row in enumerate(rows) if best is not None and row["psnr"] == best and row["num_lost"]]
    print_table((*headings, "lost", "bytes", "seconds"), lines, title, caption=_caption(rows, lpips_note), best=marked)


def _line(row: Mapping[str, Any], others: Sequence[str]) -> tuple[str, ...]:
    return (
        row["method"],
        "= reference" if row["exact"] else "infinite" if row["psnr"] is None else f"{row['psnr']:.2f}",
        f"{row['ssim']:.4f}",
        "no weights" if row["lpips"] is None else f"{row['lpips']:.4f}",
        *(_figure(row["metrics"][name], METRICS[name].digits) for name in others),
        f"{row['num_lost']:,.0f}",
        f"{row['num_bytes']:,}",
        f"{row['seconds']:.1f}",
    )


def _figure(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _caption(rows: Sequence[Mapping[str, Any]], lpips_note: str) -> str:
    parts = ", ".join(f"{name.replace('_', ' ')} {size:,}" for name, size in rows[-1]["parts"].items())
    lpips = f"\nLPIPS: {lpips_note}" if lpips_note else ""
    equal = any(row["psnr"] is None and not row["exact"] for row in rows)
    infinite = "\nPSNR is infinite if some pictures, but not all, equal their references" if equal else ""
    return f"bytes by part: {parts}{lpips}{infinite}"
