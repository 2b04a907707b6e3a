"""The table that `demo` and `evaluate` print."""

from collections.abc import Mapping, Sequence
from typing import Any

from splatwire.cli._terminal import print_table


def print_rows(rows: Sequence[Mapping[str, Any]], title: str, *, lpips_note: str) -> None:
    """Prints rows as a table on standard output.

    Args:
        rows: As `Evaluation.rows` gives them.
        title: Headline.
        lpips_note: Why there is no LPIPS, or on which views it is.
    """
    from rich.table import Table

    best = max((row["psnr"] for row in rows if row["num_lost"] and row["psnr"] is not None), default=None)
    table = Table(title=title, title_justify="left", caption=_caption(rows, lpips_note), caption_justify="left")
    for name in ("method", "PSNR dB", "SSIM", "LPIPS", "lost", "bytes", "seconds"):
        table.add_column(name, justify="left" if name == "method" else "right")
    for row in rows:
        psnr = "= reference" if row["exact"] else "-" if row["psnr"] is None else f"{row['psnr']:.2f}"
        lpips = "no weights" if row["lpips"] is None else f"{row['lpips']:.4f}"
        table.add_row(
            row["method"],
            psnr,
            f"{row['ssim']:.4f}",
            lpips,
            f"{row['num_lost']:,.0f}",
            f"{row['num_bytes']:,}",
            f"{row['seconds']:.1f}",
            style="bold green" if best is not None and row["psnr"] == best and row["num_lost"] else None,
        )
    print_table(table)


def _caption(rows: Sequence[Mapping[str, Any]], lpips_note: str) -> str:
    parts = ", ".join(f"{name.replace('_', ' ')} {size:,}" for name, size in rows[-1]["parts"].items())
    lpips = f"\nLPIPS: {lpips_note}" if lpips_note else ""
    return f"bytes by part: {parts}{lpips}"
