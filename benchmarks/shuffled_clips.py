"""Small generated clips with another order of Gaussians in every frame, and the damage of losses on them.

    python benchmarks/shuffled_clips.py > benchmarks/results/shuffled_clips.json
    python benchmarks/shuffled_clips.py walker smoke --seeds 1 --frames 20
    python benchmarks/shuffled_clips.py monkey=FRAMES/ --seeds 1

`waves`, `cloth`, `dancer`: bodies that move; the Gaussians are the same in all frames. `smoke`: Gaussians appear and
fade. `walker`, `ripples`: surfaces with other random points in each frame. `flipbook`: a turning body with separately
fitted frames, so that every Gaussian jitters and some are replaced. Settings were chosen on `walker` and `flipbook`.
`grow` hides lost tracks and enlarges the received ones.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.bitstream import packetization_named
from splatwire.channel import parse_loss
from splatwire.codec import decode_stream, encode_scene
from splatwire.concealment import register_concealer
from splatwire.concealment.temporal.concealers import temporal_concealer
from splatwire.evaluation.sequence.evaluation import SequenceRow, frame_psnr, score_sequence
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import scene_class_offsets
from splatwire.sequence import Frame, SequenceOptions, encode_sequence, frame_files, read_frames
from splatwire.sequence.description import describe_sequence
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

COUNT, FRAMES, RATE, GROUP = 3000, 30, 30.0, 10
CONCEALERS = ("drop", "hold", "grow", "motion")
TUNED = ("walker", "flipbook")
"""Clips that settings may be chosen on."""
Shape = Callable[[np.ndarray, float], np.ndarray]
"""Positions, (N, 3), of points of a surface with parameters in the unit square, (N, 2), at a time in seconds."""


def waves(at: np.ndarray, seconds: float) -> np.ndarray:
    """Water: three travelling waves; points move on circles."""
    flat = np.stack([at[:, 0] * 2 - 1, np.zeros(len(at)), at[:, 1] * 2 - 1], axis=1)
    moved = flat.copy()
    for size, angle, wave, speed in ((0.07, 0.3, 5.0, 6.0), (0.05, 1.4, 8.0, 8.0), (0.03, -0.8, 13.0, 11.0)):
        along = np.array([np.cos(angle), 0, np.sin(angle)])
        phase = flat @ along * wave - speed * seconds
        moved += size * (np.cos(phase)[:, None] * along + np.sin(phase)[:, None] * [0, 1, 0])
    return moved


def cloth(at: np.ndarray, seconds: float) -> np.ndarray:
    """A flag on a pole."""
    x, y = at[:, 0] * 1.6, at[:, 1] - 0.5
    swing = 0.28 * np.sqrt(at[:, 0]) * np.sin(7 * x - 9 * seconds + 2 * y)
    return np.stack([x - 0.8 - 0.1 * x * np.sin(4 * seconds), y - 0.06 * x * np.cos(5 * seconds), swing], axis=1)


def ball(at: np.ndarray, seconds: float) -> np.ndarray:
    """A knobbly ball that turns fast and breathes."""
    height, around = at[:, 0] * 2 - 1, at[:, 1] * 2 * np.pi
    ring = np.sqrt(1 - height**2)
    radius = 1 + 0.2 * np.sin(3 * around) * ring + 0.05 * np.sin(5 * seconds)
    turned = around + 3.5 * seconds
    return np.stack([radius * ring * np.cos(turned), radius * height, radius * ring * np.sin(turned)], axis=1)


BONES = (
    # parent bone, share of its length where it begins, length, radius, angle at rest, swing, phase, side
    (-1, 0.0, 0.6, 0.16, 0.05, 0.05, 0.0, 0.0), (0, 1.0, 0.22, 0.11, 0.0, 0.05, 0.0, 0.0),
    (0, 0.9, 0.32, 0.06, np.pi, 0.6, 0.0, 0.2), (2, 1.0, 0.3, 0.05, -0.4, 0.3, 0.6, 0.0),
    (0, 0.9, 0.32, 0.06, np.pi, 0.6, np.pi, -0.2), (4, 1.0, 0.3, 0.05, -0.4, 0.3, np.pi + 0.6, 0.0),
    (0, 0.0, 0.42, 0.09, np.pi, 0.55, np.pi, 0.1), (6, 1.0, 0.42, 0.07, 0.35, 0.4, np.pi + 1.2, 0.0),
    (0, 0.0, 0.42, 0.09, np.pi, 0.55, 0.0, -0.1), (8, 1.0, 0.42, 0.07, 0.35, 0.4, 1.2, 0.0),
)  # fmt: skip
"""A walking figure of capsules."""


def walker(at: np.ndarray, seconds: float) -> np.ndarray:
    """A figure that walks; the first parameter selects a bone and a height on it."""
    sizes = np.array([bone[2] * bone[3] for bone in BONES])
    edges = np.concatenate([[0], np.cumsum(sizes / sizes.sum())])
    bone = np.minimum(np.searchsorted(edges, at[:, 0], side="right") - 1, len(BONES) - 1)
    share, around = (at[:, 0] - edges[bone]) / np.diff(edges)[bone], at[:, 1] * 2 * np.pi
    found, frames = np.zeros((len(at), 3)), []
    for number, (parent, start, length, radius, rest, swing, phase, side) in enumerate(BONES):
        root, before = np.array([0.5 * seconds, 0.04 * abs(np.sin(7 * seconds)), 0.0]), 0.0
        if parent >= 0:
            origin, before, along = frames[parent]
            root = origin + start * along
        angle = before + rest + swing * np.sin(7 * seconds + phase)
        along = length * np.array([np.sin(angle), np.cos(angle), 0])
        root = root + np.array([0, 0, side])
        frames.append((root, angle, along))
        own = bone == number
        across = np.array([np.cos(angle), -np.sin(angle), 0])
        thick = radius * np.sqrt(np.maximum(1 - (2 * share[own] - 1) ** 6, 0.02))
        found[own] = (
            root + share[own, None] * along + (thick * np.cos(around[own]))[:, None] * across
            + (thick * np.sin(around[own]))[:, None] * [0, 0, 1]
        )  # fmt: skip
    return found


def surface(shape: Shape, at: np.ndarray, seconds: float, spread: float = 0.75) -> Splats:
    """Flat Gaussians on a surface, as large as their mean distance, with a smooth pattern of colours."""
    step = 1e-4
    positions = shape(at, seconds)
    sides = [(shape(at + step * axis, seconds) - shape(at - step * axis, seconds)) / (2 * step) for axis in np.eye(2)]
    first = sides[0] / (np.linalg.norm(sides[0], axis=1, keepdims=True) + 1e-12)
    normal = np.cross(sides[0], sides[1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    quats = quaternions(np.stack([first, np.cross(normal, first), normal], axis=2))
    area = np.linalg.norm(np.cross(sides[0], sides[1]), axis=1)
    size = spread * np.sqrt(np.median(area) / len(at))
    scales = size * np.array([1.0, 1.0, 0.15]) * np.exp(0.25 * np.sin(91 * at[:, :1] + 57 * at[:, 1:]))
    hue = np.stack([np.sin(9 * at[:, 0] + 1), np.sin(7 * at[:, 1]), np.sin(6 * at[:, 0] - 8 * at[:, 1])], axis=1)
    stripes = 0.3 * np.sign(np.sin(40 * at[:, :1]) * np.sin(30 * at[:, 1:]))
    return splats(positions, quats, scales, np.full(len(at), 0.9), 0.6 * hue + stripes)


def quaternions(matrices: np.ndarray) -> np.ndarray:
    """Quaternions (w, x, y, z), (N, 4), of rotation matrices, (N, 3, 3)."""
    m = matrices
    k = np.stack([
        np.stack([m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2], m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0],
                  m[:, 1, 0] - m[:, 0, 1]], axis=1),
        np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 0] - m[:, 1, 1] - m[:, 2, 2], m[:, 1, 0] + m[:, 0, 1],
                  m[:, 2, 0] + m[:, 0, 2]], axis=1),
        np.stack([m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] + m[:, 0, 1], m[:, 1, 1] - m[:, 0, 0] - m[:, 2, 2],
                  m[:, 2, 1] + m[:, 1, 2]], axis=1),
        np.stack([m[:, 1, 0] - m[:, 0, 1], m[:, 2, 0] + m[:, 0, 2], m[:, 2, 1] + m[:, 1, 2],
                  m[:, 2, 2] - m[:, 0, 0] - m[:, 1, 1]], axis=1),
    ], axis=1)  # fmt: skip
    return np.linalg.eigh(k)[1][:, :, 3]


def splats(
    positions: np.ndarray, quats: np.ndarray, scales: np.ndarray, opacities: np.ndarray, colours: np.ndarray
) -> Splats:
    """Gaussians without view-dependent colour."""
    values = (positions, quats, scales, opacities, colours[:, None])
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


def smoke(rng: np.random.Generator, count: int) -> Callable[[float], Splats]:
    """Puffs that rise, swirl, grow and fade; each lives for about a second."""
    birth, life = rng.uniform(-1.2, 1.2, count), rng.uniform(0.7, 1.3, count)
    start = rng.normal(0, [0.12, 0.03, 0.12], (count, 3))
    drift, grey = rng.normal(0, 0.12, (count, 3)), rng.uniform(-0.6, 0.8, (count, 1))

    def frame(seconds: float) -> Splats:
        there = np.flatnonzero((birth <= seconds) & (seconds < birth + life))
        age = (seconds - birth[there])[:, None]
        share = age[:, 0] / life[there]
        height = 1.5 * age
        swirl = 0.25 * age * np.concatenate([np.sin(6 * height - 4 * seconds + grey[there]), 0 * age,
                                             np.cos(5 * height - 3 * seconds)], axis=1)  # fmt: skip
        positions = start[there] * (1 + 2 * age) + height * [0, 1, 0] + swirl + drift[there] * age
        scales = np.repeat(0.03 + 0.05 * age, 3, axis=1)
        quats = np.tile([1.0, 0, 0, 0], (len(there), 1))
        opacities = np.maximum(0.5 * np.sin(np.pi * share), 0.01)
        return splats(positions, quats, scales, opacities, grey[there] + np.array([0.3, 0.1, 0]))

    return frame


def flipbook(rng: np.random.Generator, count: int) -> Callable[[float], Splats]:
    """A turning body with separately fitted frames."""
    sites, colours = rng.random((count, 2)), rng.normal(0, 0.3, (count, 1, 3))

    def frame(seconds: float) -> Splats:
        changed = rng.random(count) < 0.02
        sites[changed] = rng.random((int(changed.sum()), 2))
        jitter = rng.normal(0, 0.2 / np.sqrt(count), sites.shape)
        found = surface(ball, np.clip(sites + jitter, 1e-3, 1 - 1e-3), 0.2 * seconds)
        scales = found.scales * np.exp(rng.normal(0, 0.03, (count, 3)))
        sh = found.sh + colours + rng.normal(0, 0.02, found.sh.shape)
        return replace(found, scales=scales.astype(np.float32), sh=sh.astype(np.float32))

    return frame


def fixed_points(shape: Shape) -> Callable[[np.random.Generator, int], Callable[[float], Splats]]:
    """Shape with the same points in all frames."""

    def begin(rng: np.random.Generator, count: int) -> Callable[[float], Splats]:
        at = rng.random((count, 2))
        return lambda seconds: surface(shape, at, seconds)

    return begin


def resampled_points(shape: Shape) -> Callable[[np.random.Generator, int], Callable[[float], Splats]]:
    """Shape with other random points in each frame."""
    return lambda rng, count: lambda seconds: surface(shape, rng.random((count, 2)), seconds)


CLIPS = {
    "waves": fixed_points(waves), "cloth": fixed_points(cloth), "dancer": fixed_points(walker), "smoke": smoke,
    "walker": resampled_points(walker), "ripples": resampled_points(waves), "flipbook": flipbook,
}  # fmt: skip


def shuffled_frames(name: str, *, count: int = COUNT, frames: int = FRAMES, seed: int = 1) -> Iterator[Splats]:
    """Frames of a generated clip, each in another order.

    Args:
        name: One of `CLIPS`.
        count: Number of Gaussians.
        frames: Number of frames, at `RATE` frames a second.
        seed: Seed of the positions and of the order of Gaussians.
    """
    rng = np.random.default_rng(seed)
    made = CLIPS[name](rng, count)
    for number in range(frames):
        found = made(number / RATE)
        yield found.select(rng.permutation(found.num_gaussians))


def frame_by_frame(frames: list[Frame], cameras, quality: str) -> tuple[float, float]:
    """Mean PSNR and bytes of a frame as a still scene."""
    points = []
    for frame in frames[::5]:
        scene = SplatScene(frame.splats.select(frame.drawn))
        packets = packetization_named("datagram", "gaussians", scene.num_elements)
        stream = encode_scene(
            scene, packets, quality=quality, class_offsets=scene_class_offsets(scene, None, recompute=True)
        )
        shown = np.stack(list(iterate_views(decode_stream(stream).scene, cameras)))
        points.append((frame_psnr(shown, np.stack(list(iterate_views(scene, cameras)))), stream.num_bytes))
    return tuple(np.mean(points, axis=0).tolist())


def measure(name: str, arguments: argparse.Namespace) -> dict:
    """Figures of one clip: bytes, and PSNR of each concealer below the complete clip."""
    name, _, folder = name.partition("=")
    if folder:
        frames = list(read_frames(frame_files(Path(folder))[: arguments.frames]))
    else:
        frames = [Frame.of(one) for one in shuffled_frames(name, count=arguments.count, frames=arguments.frames)]
    began = time.process_time()
    stream, tracking = encode_sequence(iter(frames), SequenceOptions(group_frames=arguments.group))
    seconds = time.process_time() - began
    cameras = surrounding_cameras(SplatScene(frames[0].splats.select(frames[0].drawn)), arguments.views, 160)
    rows = [SequenceRow("motion")] + [
        SequenceRow(concealer, parse_loss(arguments.loss, "datagram"), seed, arguments.loss)
        for concealer in arguments.concealers for seed in arguments.seeds
    ]  # fmt: skip
    complete, *others = score_sequence(stream, iter(frames), cameras, rows)
    found = {"name": name, "tuned": name in TUNED, "frames": len(frames), "matched": tracking.matched_share,
             "group_frames": describe_sequence(stream)["group_frames"],
             "packets": len(stream.packets), "bytes": stream.num_bytes, "seconds": seconds,
             "complete": complete.mean}  # fmt: skip
    if arguments.sizes:
        low, high = (frame_by_frame(frames, cameras, quality) for quality in ("small", "default"))
        decibels = float(complete.psnr.mean())
        share = (decibels - low[0]) / (high[0] - low[0])
        still = float(np.exp(np.log(low[1]) + share * (np.log(high[1]) - np.log(low[1]))))
        found["ratio"] = stream.num_bytes / (still * len(frames))
    for concealer in arguments.concealers:
        own = [score for score in others if score.row.concealer == concealer]
        found[concealer] = [round(score.mean, 3) for score in own]
        found[f"{concealer}_flicker"] = float(np.mean([score.flicker for score in own]) / max(complete.flicker, 1e-12))
    return found


def growing(**options: Any) -> Any:
    """Returns the concealer that leaves out lost Gaussians and enlarges received ones."""
    left_out: Any = temporal_concealer("drop")
    return replace(left_out, grow=True, **options)


def main() -> None:
    """Measures clips."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", default=list(CLIPS), help=f"{', '.join(CLIPS)}, or NAME=FOLDER")
    parser.add_argument("--loss", default="bernoulli:0.2")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--concealers", nargs="+", default=CONCEALERS)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--group", type=int, default=GROUP)
    parser.add_argument("--sizes", action="store_true", help="also code frame by frame")
    arguments = parser.parse_args()
    register_concealer("grow", temporal=True)(growing)
    print(json.dumps([measure(name, arguments) for name in arguments.clips], indent=1))


if __name__ == "__main__":
    main()
