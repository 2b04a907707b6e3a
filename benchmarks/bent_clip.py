"""A clip with known motion: a real capture that a smooth field bends, half of it static.

    python benchmarks/bent_clip.py $SPLATWIRE_DATA/splats/guitar.compressed.ply -o out/guitar --frames 30

Some colours change over time, and some Gaussians appear or disappear. Row i is always the same Gaussian (absent ones
are nearly transparent), unless `--shuffled` is given.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.io import open_scene
from splatwire.io.formats import write_splats
from splatwire.types.splats import Splats

AMPLITUDE = 0.06
"""Amplitude of the field, relative to the scene's extent."""
CHANGED = 0.02
"""Share of the Gaussians that appear or disappear."""
ABSENT = 1e-5


@dataclass(frozen=True, eq=False)
class Field:
    """A smooth field that bends space over time.

    Attributes:
        middle: Centre of the scene, float64 (3).
        extent: Size of the scene, world units.
        waves: Wave vectors of the S sines that move each axis, float64 (S, 3).
        phases: Phase of each sine, radians, float64 (S, 3).
        speeds: Angular frequency of each sine, radians per second, float64 (S).
    """

    middle: np.ndarray
    extent: float
    waves: np.ndarray
    phases: np.ndarray
    speeds: np.ndarray

    @staticmethod
    def of(splats: Splats, seed: int) -> "Field":
        """A field for a scene."""
        low, high = np.quantile(splats.means.astype(np.float64), [0.02, 0.98], axis=0)
        rng = np.random.default_rng(seed)
        waves, phases = rng.uniform(1.5, 5.0, (3, 3)) * rng.choice([-1, 1], (3, 3)), rng.uniform(0, 2 * np.pi, (3, 3))
        return Field((low + high) / 2, float((high - low).max()), waves, phases, rng.uniform(3.0, 6.0, 3))

    def moved(self, positions: np.ndarray, seconds: float) -> np.ndarray:
        """Moved positions, float64 (N, 3); equal to the original at 0 s, and on the static side."""
        unit = (positions - self.middle) / self.extent
        ramp = np.clip(unit[:, :1] * 6, 0, 1)
        ramp = ramp * ramp * (3 - 2 * ramp)
        angles = unit @ self.waves.T
        waves = [np.sin(angles + phase + self.speeds * seconds) - np.sin(angles + phase) for phase in self.phases]
        shift = np.stack([wave @ np.array([0.6, 0.3, 0.1]) for wave in waves], axis=1)
        return positions + AMPLITUDE * self.extent * ramp * shift

    def turned(self, positions: np.ndarray, seconds: float) -> np.ndarray:
        """Rotation of space at some positions, quaternions (w, x, y, z), float64 (N, 4): polar part of the Jacobian."""
        step = 1e-4 * self.extent
        sides = [
            self.moved(positions + step * axis, seconds) - self.moved(positions - step * axis, seconds)
            for axis in np.eye(3)
        ]
        u, _, v = np.linalg.svd(np.stack(sides, axis=2) / (2 * step))
        m = u @ v
        trace = np.trace(m, axis1=1, axis2=2)
        w = np.sqrt(np.maximum(1 + trace, 1e-9)) / 2
        x, y, z = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
        quats = np.stack([w, x / (4 * w), y / (4 * w), z / (4 * w)], axis=1)
        return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def multiply(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Hamilton products (N, 4): the rotation `second`, then `first`."""
    a, b, c, d = first.T
    w, x, y, z = second.T
    rows = [
        a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w,
    ]  # fmt: skip
    return np.stack(rows, axis=1)


def bent_frames(splats: Splats, frames: int, *, rate: float = 30.0, seed: int = 1) -> Iterator[Splats]:
    """Frames of a clip; row i is the same Gaussian in each.

    Args:
        splats: Gaussians of the capture.
        frames: Number of frames.
        rate: Frames per second.
        seed: Seed of the field, and of the Gaussians that appear and disappear.
    """
    field, rng = Field.of(splats, seed), np.random.default_rng(seed + 1)
    count, positions = splats.num_gaussians, splats.means.astype(np.float64)
    begins, ends = np.zeros(count, int), np.full(count, frames)
    changed = rng.permutation(count)[: int(CHANGED * count)]
    born, dying = np.array_split(changed, 2)
    if frames > 2:
        begins[born], ends[dying] = rng.integers(1, frames, len(born)), rng.integers(1, frames, len(dying))
    breathing = positions[:, 1] > field.middle[1]
    for frame in range(frames):
        seconds = frame / rate
        moves = field.moved(positions, seconds)
        still = (moves == positions).all(axis=1)
        quats = multiply(field.turned(positions, seconds).astype(np.float32), splats.quats)
        quats[still] = splats.quats[still]
        there = (begins <= frame) & (frame < ends)
        gain = np.float32(1 + 0.12 * np.sin(4 * seconds))
        sh = np.where(breathing[:, None, None], splats.sh * gain, splats.sh)
        yield Splats(
            moves.astype(np.float32), quats, splats.scales,
            np.where(there, splats.opacities, np.float32(ABSENT)), sh,
        )  # fmt: skip


def shuffled(splats: Splats, seed: int) -> Splats:
    """The present Gaussians of a frame in random order."""
    there = np.flatnonzero(splats.opacities > ABSENT * 2)
    order = np.random.default_rng(seed).permutation(len(there))
    return splats.select(there[order])


def capture(path: Path, degree: int, most: int | None) -> Splats:
    """A capture, limited in harmonics degree and number of Gaussians (every n-th is kept)."""
    splats = open_scene(path).elements
    splats = splats.at_most_degree(min(degree, splats.degree))
    if most is None or splats.num_gaussians <= most:
        return splats
    return splats.select(np.linspace(0, splats.num_gaussians - 1, most).astype(np.int64))


def main() -> None:
    """Writes a clip."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--degree", type=int, default=3)
    parser.add_argument("--most", type=int)
    parser.add_argument("--shuffled", action="store_true")
    parser.add_argument("--format", choices=("ply", "spz", "sog", "splat"), default="ply")
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    splats = capture(args.capture, args.degree, args.most)
    for frame, bent in enumerate(bent_frames(splats, args.frames, rate=args.rate, seed=args.seed)):
        chosen = shuffled(bent, args.seed * 1000 + frame) if args.shuffled else bent
        write_splats([chosen], args.output / f"frame_{frame:04d}.{args.format}")


if __name__ == "__main__":
    main()
