"""Loses packets of a stream, conceals with every method, and says how far each is from the lossless picture.

Usage: python examples/lose_and_conceal.py STREAM CAMERAS [LOSS]

The bundled scene is `src/splatwire/assets/snowmiku.swz` with `snowmiku_cameras.json`.
"""

import sys
from pathlib import Path

from splatwire import decode_stream, parse_loss, read_stream, render_scene, transmit
from splatwire.concealment import conceal, concealer_names
from splatwire.data import load_cameras
from splatwire.metrics import psnr


def main(stream_path: str, cameras_path: str, loss: str = "bernoulli:0.2") -> None:
    """Prints one line per concealer."""
    stream, _ = read_stream(stream_path)
    cameras = load_cameras(Path(cameras_path)).select([0])
    reference = render_scene(decode_stream(stream).scene, cameras)
    received, record = transmit(stream, parse_loss(loss), seed=0)
    print(f"{record.num_lost} of {record.num_sent} packets ({record.unit}) lost")
    received_scene = decode_stream(received)
    for name in concealer_names(received_scene.sections, received_scene.provides):
        image = render_scene(conceal(received_scene, name), cameras)
        print(f"{name:8} {psnr(image, reference)[0]:6.2f} dB")


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    main(*sys.argv[1:])
