"""Total bytes and fidelity of a stream by the noise that the context networks' weights may add.

    python benchmarks/weight_precision.py [--data ../shared/data] [--models ...] [--output FILE]

`default` is the noise that the encoder chooses by itself. `error` is the root mean square of the changes by
re-quantisation, over the spread of the attribute.
"""

import argparse
from pathlib import Path

import numpy as np
from figures import publish

from splatwire.codec import decode_stream, encode_scene, scene_in_order, side_info_parts
from splatwire.neural.importers.hacpp import import_hacpp
from splatwire.types import AnchorScene

NOISES = (None, 0.01, 0.02, 0.03, 0.04, 0.05, 0.07, 0.1)


def measure(scene: AnchorScene, noise: float | None) -> dict[str, object]:
    stream = encode_scene(scene, network_tolerance=noise)
    original, decoded = scene_in_order(scene, "morton").anchors, decode_stream(stream).scene.anchors
    parts = side_info_parts(stream.side_info, stream.manifest.schema_name)
    error: dict[str, float] = {}
    for name in ("features", "scalings", "offsets"):
        before, after = getattr(original, name), getattr(decoded, name)
        error[name] = round(float(np.sqrt(((before - after) ** 2).mean()) / before.std()), 5)
    return {
        "noise": "default" if noise is None else noise,
        "num_bytes": stream.num_bytes,
        "network_bytes": parts["prior_network"] + parts["channel_networks"],
        "packet_bytes": stream.part_sizes()["packet_payloads"],
        "error": error,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--models", nargs="+", default=["snowmiku_small_2400", "snowmiku_15k", "bonsai_30k"])
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    result = {}
    for name in arguments.models:
        scene = import_hacpp(arguments.data / "hacpp" / name)
        result[name] = [measure(scene, noise) for noise in NOISES]
    publish(result, arguments.output)


if __name__ == "__main__":
    main()
