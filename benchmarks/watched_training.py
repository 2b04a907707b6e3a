"""Updates of a scene that is trained, once a second, against SPZ snapshots (`splatwire.serve_training`).

    python benchmarks/watched_training.py $SPLATWIRE_DATA/splats/tandt_truck_opensplat_116k.splat > training.json

The training is simulated: all attributes approach those of the scene by 8 % a second, and each step jitters them. Each
second, the share of the Gaussians whose change since they were sent matters most (change times the root of the covered
area) is sent as an update. PSNR is that of four views of the scene, for the trainer and for a receiver of all updates.
"""

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.codec import decode_stream
from splatwire.io import open_scene
from splatwire.io.formats import write_splats
from splatwire.rate_control.partial_updates import PartialUpdates
from splatwire.render import render_scene
from splatwire.render.importance import surrounding_cameras
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

SHARES, SECONDS = (0.1, 0.2), 5
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


def main() -> None:
    """Measures updates with both shares."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    scene = open_scene(parser.parse_args().scene)
    assert isinstance(scene, SplatScene)
    target = scene.select(scene.drawable).splats
    cameras = surrounding_cameras(SplatScene(target), 4, 192)
    reference = np.asarray(render_scene(SplatScene(target), cameras), np.float64)

    def psnr(splats: Splats) -> float:
        pictures = np.asarray(render_scene(SplatScene(splats), cameras), np.float64)
        return round(float(-10 * np.log10(np.mean((pictures - reference) ** 2))), 2)

    rows = []
    for share in SHARES:
        state = PartialUpdates.start(trained(target, 0))
        for second in range(1, SECONDS + 1):
            trainer = trained(target, second)
            state = state.pushed(trainer, share)
            update = state.chain.updates[-1]
            snapshot = snapshot_bytes(trainer)
            rows.append({
                "share": share, "second": second, "update_bytes": update.num_bytes, "spz_bytes": snapshot,
                "ratio": round(update.num_bytes / snapshot, 4), "trainer_db": psnr(trainer),
                "receiver_db": psnr(decode_stream(state.chain.scene).scene.splats),
            })  # fmt: skip
    print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
