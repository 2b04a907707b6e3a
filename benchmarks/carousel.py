"""One sender without feedback: PSNR and completion of receivers that join a broadcast of levels of detail.

    python benchmarks/carousel.py --draw docs/images/carousel.webp > benchmarks/results/carousel.json

Simulates `JOINS` joins at random times with independent losses. `fountain`: repair symbols of the whole file. `plain`:
the packets in a loop, coarsest level first. `spread`: the packets in a loop, in random order. `weighted`: each level
has its own loop; RaptorQ symbols replace its lost packets, and coarse levels get more than their part of the air time.
Each receiver is assumed to join at the beginning of these loops, which no sender can do for all.
Sizes and PSNR are those of `levels.json`; a partly received level counts as in its measurement of the
concealer `coarse`, and an empty picture as `EMPTY_DB`. `curve` is the mean PSNR at `TIMES[CURVE]`, `complete_by` the
share of receivers with the complete scene at these times, both in units of the file's air time.
"""

import argparse
import json
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).parent / "results"
PACKET, JOINS, LOSS, EMPTY_DB = 1150, 200, 0.1, 10.0
OVERHEAD = 2
"""Symbols that a RaptorQ decoder needs beyond the number of source symbols."""
SHARES = {"weighted": (0.05, 0.14, 0.81), "weighted, 1.2": (0.09, 0.18, 0.73)}
"""Air time of the levels, coarsest first. The finest level then ends within 1.1 and 1.2 of the ideal time."""
TIMES = np.linspace(0, 3, 301)
CURVE = slice(0, 201, 5)
"""Entries of `TIMES` that are stored and drawn as curves: every 0.05 to 2."""
NAMES = {
    "fountain": "RaptorQ over the whole file", "plain": "packets, coarsest level first",
    "spread": "packets in random order",
}  # fmt: skip


def order_of(way: str, sizes: list[int], rng: np.random.Generator, slots: int) -> tuple[np.ndarray, np.ndarray]:
    """Level and number of each packet that is sent after a join; number -1: a repair symbol of the file."""
    level, number = np.repeat(np.arange(len(sizes)), sizes), np.concatenate([np.arange(n) for n in sizes])
    if way == "fountain":
        return np.zeros(slots, int), np.full(slots, -1)
    if way in ("plain", "spread"):
        order = np.arange(len(level)) if way == "plain" else rng.permutation(len(level))
        at = order[(rng.integers(len(level)) + np.arange(slots)) % len(level)]
        return level[at], number[at]
    levels, numbers = rng.choice(len(sizes), slots, p=SHARES[way]), np.zeros(slots, int)
    for one, size in enumerate(sizes):
        own = np.flatnonzero(levels == one)
        numbers[own] = np.arange(len(own)) % size
        numbers[own[size:]] = -1  # replacements of what was lost in the first circle
    return levels, numbers


def join(way: str, sizes: list[int], curve, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Simulates one receiver: PSNR at `TIMES` in units of the file's duration, and time of completion."""
    total = sum(sizes)
    slots = int(TIMES[-1] * total) + 1
    levels, numbers = order_of(way, sizes, rng, slots)
    arrived = rng.random(slots) >= LOSS
    needed = np.array([total] if way == "fountain" else sizes)
    got, symbols = [np.zeros(n, bool) for n in sizes], np.zeros(len(needed), int)
    psnr, done, at = np.zeros(len(TIMES)), np.inf, 0
    for index, moment in enumerate(TIMES):
        while at < int(moment * total):
            if arrived[at]:
                level, number = levels[at], numbers[at]
                if number < 0 or not got[level][number]:
                    symbols[level] += 1
                if number >= 0:
                    got[level][number] = True
            at += 1
        coded = way not in ("plain", "spread")
        whole = symbols >= needed + OVERHEAD * coded
        if coded:
            whole |= np.array([way != "fountain" and one.all() for one in got[: len(needed)]])
        shares = [float(one.mean()) for one in got]
        shares = [1.0 if whole[min(n, len(whole) - 1)] else share for n, share in enumerate(shares)]
        psnr[index] = curve(shares)
        if whole.all() and not np.isfinite(done):
            done = float(moment)
    return psnr, done


def draw(rows: list[dict], path: Path) -> None:
    """Draws the mean PSNR and the share of complete receivers over the time since the join."""
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    for row in rows:
        shares = "" if row["shares"] is None else " / ".join(f"{100 * share:.0f}" for share in row["shares"]) + " %"
        left.plot(TIMES[CURVE], row["curve"], label=NAMES.get(row["way"], f"RaptorQ for each level, {shares}"))
        right.plot(TIMES[CURVE], 100 * np.array(row["complete_by"]))
    left.set_ylabel("mean PSNR, dB")
    right.set_ylabel("receivers with the complete scene, %")
    for axis in (left, right):
        axis.set_xlabel("time since the join, air times of the file")
        axis.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    figure.savefig(path, dpi=90)


def main() -> None:
    """Simulates all ways on truck."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", type=Path, help="path of a picture of the results")
    args = parser.parse_args()
    scene = json.loads((RESULTS / "levels.json").read_text())[0]
    levels = scene["levels"][::-1]
    sizes, best = [-(-level["bytes"] // PACKET) for level in levels], [level["psnr"] for level in levels]
    parent, own = best[-2:]
    lost = {float(rate): values["coarse"] for rate, values in scene["loss"].items()} | {0.0: own, 1.0: parent}
    rates = sorted(lost, reverse=True)
    gains = [(lost[rate] - parent) / (own - parent) for rate in rates]

    def curve(shares: list[float]) -> float:
        shown = EMPTY_DB
        for share, top in zip(shares, best, strict=True):
            shown += (top - shown) * float(np.interp(share, [1 - rate for rate in rates], gains))
        return shown

    found, half = [], (TIMES > 0) & (TIMES <= 0.5)
    for way in ("fountain", "plain", "spread", *SHARES):
        rng = np.random.default_rng(1)
        runs = [join(way, sizes, curve, rng) for _ in range(JOINS)]
        psnr = np.mean([run[0] for run in runs], axis=0)
        ends = np.array([run[1] for run in runs])
        found.append({
            "way": way, "shares": SHARES.get(way), "first_half": float(psnr[half].mean()),
            **{f"after_{round(100 * t)}": float(psnr[np.abs(TIMES - t).argmin()]) for t in (0.05, 0.15, 0.5, 1.0)},
            "complete_share": float(np.isfinite(ends).mean()),
            "complete": float(ends.mean()) if np.isfinite(ends).all() else None,
            "curve": psnr[CURVE].round(2).tolist(),
            "complete_by": [float((ends <= t).mean()) for t in TIMES[CURVE]],
        })  # fmt: skip
    if args.draw:
        draw(found, args.draw)
    print(json.dumps({"scene": scene["scene"], "packets": sizes, "rows": found}, indent=1))


if __name__ == "__main__":
    main()
