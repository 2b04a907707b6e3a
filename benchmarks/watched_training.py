"""Updates of a scene that is trained, once a second, against SPZ snapshots (`splatwire.serve_training`).

    cd $SPLATWIRE_DATA/splats
    python benchmarks/watched_training.py tandt_truck_opensplat_116k.splat guitar.compressed.ply > training.json

The training is simulated: all attributes approach those of the scene by 8 % a second, and each step jitters them. Each
second, an update contains a share of the Gaussians: those with the largest effect on pictures by their change since
their last transmission. PSNR is that of `HELD_OUT_VIEWS` views of the scene, for the trainer and for a receiver of all
updates. No update is chosen in these views.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.codec import decode_stream
from splatwire.io import open_scene
from splatwire.io.formats import write_splats
from splatwire.rate_control.partial_updates import SHARE, PartialUpdates
from splatwire.render import render_scene
from splatwire.render.importance import HELD_OUT_VIEWS, surrounding_cameras
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

SHARES, SECONDS, SIZE = (SHARE, 0.2), 5, 192
DECAY, JITTER = 0.92, 0.02
DISTANCES = {"means": 0.6, "scales": 0.25, "opacities": 0.15, "sh": 0.25}
"""Standard deviation of each attribute from its final value when the watching begins: positions in multiples of a
Gaussian's mean size, logarithms of scales, opacities, coefficients.
"""


def sizes_of(splats: Splats) -> np.ndarray:
    """Geometric mean of the standard deviations of each Gaussian, (N, 1)."""
    return np.exp(np.log(splats.scales).mean(axis=1, keepdims=True))


def trained(target: Splats, second: int) -> Splats:
    """Scene after some seconds of simulated training."""
    start, step = np.random.default_rng(0), np.random.default_rng(second + 1)
    found = {}
    for name, distance in DISTANCES.items():
        shape = getattr(target, name).shape
        unit = sizes_of(target) if name == "means" else 1.0
        noise = DECAY**second * start.normal(size=shape) + JITTER * step.normal(size=shape)
        found[name] = (distance * noise * unit).astype(np.float32)
    return replace(
        target, means=target.means + found["means"], scales=target.scales * np.exp(found["scales"]),
        opacities=np.clip(target.opacities + found["opacities"], 0.01, 0.99), sh=target.sh + found["sh"],
    )  # fmt: skip


def snapshot_bytes(splats: Splats) -> int:
    """Bytes of an SPZ file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "snapshot.spz"
        write_splats([splats], path)
        return path.stat().st_size


class TestPictures:
    """Pictures of a scene in views that choose no update."""

    def __init__(self, target: Splats) -> None:
        """Renders the final scene."""
        self.cameras = surrounding_cameras(SplatScene(target), HELD_OUT_VIEWS, SIZE)
        self.reference = self._rendered(target)

    def psnr(self, splats: Splats) -> float:
        """PSNR of all views together, dB."""
        return round(float(-10 * np.log10(np.mean((self._rendered(splats) - self.reference) ** 2))), 2)

    def _rendered(self, splats: Splats) -> np.ndarray:
        return np.asarray(render_scene(SplatScene(splats), self.cameras), np.float64)


def watched(target: Splats, share: float) -> Iterator[tuple[dict[str, Any], SceneStream]]:
    """Yields the row and the update of each second."""
    pictures = TestPictures(target)
    state = PartialUpdates.start(trained(target, 0))
    for second in range(1, SECONDS + 1):
        trainer = trained(target, second)
        state = state.pushed(trainer, share)
        update, snapshot = state.chain.updates[-1], snapshot_bytes(trainer)
        yield {
            "share": share, "second": second, "update_bytes": update.num_bytes, "spz_bytes": snapshot,
            "ratio": round(update.num_bytes / snapshot, 4), "trainer_db": pictures.psnr(trainer),
            "receiver_db": pictures.psnr(decode_stream(state.chain.scene).scene.splats),
        }, update  # fmt: skip


def target_of(path: Path) -> Splats:
    """Drawable Gaussians of a file."""
    scene = open_scene(path)
    assert isinstance(scene, SplatScene)
    return scene.select(scene.drawable).splats


def main() -> None:
    """Measures all scenes and shares."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", type=Path, nargs="+")
    rows = [
        {"scene": path.name, **row}
        for path in parser.parse_args().scenes
        for share in SHARES
        for row, _ in watched(target_of(path), share)
    ]
    print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
