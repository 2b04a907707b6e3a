"""Processor time of a view without loss and after concealment, as JSON.

The paper: loss leaves the frame rate unchanged.

    python benchmarks/frame_rate.py whole.swz PHOTOS [--views 4] [--rounds 12]

All scenes are rendered in turn in each round, on one thread; the figure is the median over rounds, in milliseconds.
"""

import argparse
import statistics
import time
from pathlib import Path

from figures import publish

from splatwire.bitstream import read_stream
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream
from splatwire.concealment import conceal
from splatwire.data import open_dataset
from splatwire.evaluation.views import spread
from splatwire.ops.threads import use_single_thread
from splatwire.render import render_scene


def main() -> None:
    """Measures all scenes in turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stream", type=Path)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--loss", default="bernoulli:0.2")
    parser.add_argument("--conceal", nargs="*", default=["drop", "cari", "idw", "grow"])
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    use_single_thread()
    stream = read_stream(options.stream)[0]
    cameras = open_dataset(options.photos, split="test").cameras
    cameras = cameras.select(spread(cameras.num_views, options.views))
    received = decode_stream(transmit(stream, parse_loss(options.loss), seed=0)[0])
    scenes = {"no loss": decode_stream(stream).scene, **{n: conceal(received, n) for n in options.conceal}}
    times: dict[str, list[float]] = {name: [] for name in scenes}
    for _ in range(options.rounds):
        for name, scene in scenes.items():
            started = time.process_time()
            render_scene(scene, cameras)
            times[name].append(1000 * (time.process_time() - started) / cameras.num_views)
    figures = {name: round(statistics.median(values), 1) for name, values in times.items()}
    publish({"stream": options.stream.name, "milliseconds_a_view": figures}, options.output)


if __name__ == "__main__":
    main()
