"""Small clips with known motion: half of a shell sways, some Gaussians appear or disappear, colours change."""

import json
import struct
from collections.abc import Collection
from dataclasses import replace

import numpy as np
from scipy.spatial.distance import cdist

from close import unit
from random_numbers import Numbers
from splatwire.sequence import Frame
from splatwire.types.splats import Splats

FRAMES = 10
GAUSSIANS = [
    # position, rotation, scale, colour, motion (t, t squared, t cubed), angular velocity, centre, width
    ((1, 2, 3), (1, 0, 0, 0), (0.5, 0.25, 0.125), (255, 0, 51, 255), ((1, 0, 0), (0, 2, 0), (0, 0, 4)),
     (0, 1, 0, 0), 0.25, 4.0),
    ((-1, 0, 0), (2, 0, 0, 0), (0.5, 0.5, 0.5), (0, 255, 0, 102), ((0, 0, 0),) * 3, (0, 0, 0, 0), 0.5, 0.125),
]  # fmt: skip
"""Sizes of a `.splatv` file."""


def moving_frames(count: int = 600, frames: int = FRAMES, seed: int = 0, *, still: bool = False) -> list[Splats]:
    """Frames with fixed rows: row i is Gaussian i, and absent Gaussians have opacity 0."""
    rng = Numbers(seed)
    means = unit(rng.randn(count, 3))
    quats = unit(rng.randn(count, 4))
    scales = np.exp(rng.randn(count, 3) * 0.3 - 3.5)
    opacities = rng.rand(count) * 0.8 + 0.15
    sh = means[:, None] * 0.4
    begins, ends = np.zeros(count, np.float32), np.full((count,), frames, np.float32)
    begins[: count // 50], ends[count // 50 : count // 25] = frames // 2, frames // 2 + 1
    found = []
    for frame in range(frames):
        time = 0.0 if still else frame / 10
        sway = np.stack([np.sin(time + means[:, 1]), time * means[:, 0], 0 * means[:, 0]], axis=1)
        moved = means + 0.2 * sway * (means[:, :1] > 0)
        here = np.ones(count, np.float32) if still else ((begins <= frame) & (frame < ends)).astype(np.float32)
        colours = sh * (1 + 0.3 * np.sin(time))
        found.append(Splats(*(t for t in (moved, quats, scales, opacities * here, colours))))
    return found


def darkened(frames: list[Splats], dark: Collection[int]) -> list[Splats]:
    """The frames, some of them without Gaussians."""
    return [
        replace(splats, opacities=np.zeros_like(splats.opacities)) if number in dark else splats
        for number, splats in enumerate(frames)
    ]


def cut_frames(count: int, frames: int, sizes: Collection[float]) -> list[Splats]:
    """Frames with scene cuts: `frames` frames of each of several scenes, which have the given sizes."""
    return [
        replace(splats, means=splats.means * np.float32(size), scales=splats.scales * np.float32(size))
        for number, size in enumerate(sizes)
        for splats in moving_frames(count + number, frames, seed=number)
    ]


def lasting_frames(frames: int, sizes: Collection[float], lasting: int = 40) -> list[Splats]:
    """Frames with the scene cuts of `cut_frames`; some further Gaussians of the first size move in all frames."""
    last = moving_frames(lasting, frames * len(sizes), seed=9)
    scenes = [moving_frames(300, frames, seed=number) for number in range(len(sizes))]
    found = []
    for time, kept in enumerate(last):
        rows = [kept]
        for number, size in enumerate(sizes):
            splats, here = scenes[number][time % frames], time // frames == number
            means, scales = splats.means * np.float32(size), splats.scales * np.float32(size)
            rows.append(replace(splats, means=means, scales=scales, opacities=splats.opacities * np.float32(here)))
        found.append(Splats(*(np.concatenate([getattr(r, name) for r in rows]) for name in vars(kept))))
    return found


def shuffled(frames: list[Splats], seed: int = 0) -> list[Splats]:
    """The frames, each with its present Gaussians in random order."""
    rng = Numbers(seed)
    found = []
    for splats in frames:
        there = splats.select(splats.opacities > 0)
        found.append(there.select(rng.randperm(there.num_gaussians)))
    return found


def drawn(splats: Splats) -> Splats:
    """Visible Gaussians of a frame."""
    frame = Frame.of(splats)
    return splats.select(frame.drawn)


def cloud(count: int, seed: int, size: float = 1.0) -> Splats:
    """Gaussians of random colours and sizes in a ball."""
    rng = Numbers(seed)
    means = unit(rng.randn(count, 3))
    means *= size * rng.rand(count, 1) ** (1 / 3)
    quats = unit(rng.randn(count, 4))
    scales = size * np.exp(rng.randn(count, 3) * 0.4 - 3.5)
    return Splats(
        means,
        quats,
        scales,
        rng.rand(count) * 0.7 + 0.25,
        rng.randn(count, 1, 3),
    )


def errors(frame: Splats, shown: Splats) -> np.ndarray:
    """Distance of each Gaussian of a frame from the nearest shown Gaussian, in units of its size, and in colour."""
    distance = cdist(frame.means.astype(np.float64), shown.means.astype(np.float64))
    near = distance.argmin(axis=1)
    far = np.take_along_axis(distance, near[:, None], axis=1)[:, 0] / frame.scales.max(axis=1)
    return far + np.abs(shown.sh[near, 0] - frame.sh[:, 0]).max(axis=1)


def halves(*numbers: float) -> bytes:
    return struct.pack(f"<{len(numbers)}e", *numbers)


def splatv(gaussians=GAUSSIANS, width: int = 16, before: bytes = b"") -> bytes:
    """A file in the layout of splaTV: lines of `width` pixels of 16 bytes, the last one padded."""
    texture = b"".join(
        struct.pack("<3f", *place) + halves(*rotation, *scale, 0) + bytes(color)
        + halves(*(number for power in motion for number in power), 0, *turning, center, spread)
        for place, rotation, scale, color, motion, turning, center, spread in gaussians
    )  # fmt: skip
    texture = texture.ljust(-(-len(texture) // (16 * width)) * 16 * width, b"\0")
    pieces = [{"type": "other", "size": len(before)}] if before else []
    pieces.append({"type": "splat", "size": len(texture), "texwidth": width, "texheight": 1, "cameras": []})
    head = json.dumps(pieces).encode()
    return struct.pack("<II", 0x674B, len(head)) + head + before + texture
