"""Speed and memory of encoding and decoding clips. Frames are generated during encoding.

    python benchmarks/clip_speed.py CAPTURE [--tracks 50000] [--frames 45] [--threads 2]
    python benchmarks/clip_speed.py CAPTURE --live [--tracks 30000]
    python benchmarks/clip_speed.py --memory 30 60 120 [--tracks 100000]

The capture is bent as `bent_clip.py` does. Wall and processor time are both reported; the second is more meaningful on
a shared machine. The first group is separate, because it renders the scene from all sides and fits tables. With
`--live`, of groups of eight: processor time of one thread between a group's last frame and its frames at a receiver,
step by step. With `--memory`, clips of the given numbers of frames show a random swaying ball, each in a separate
process.
"""

import argparse
import itertools
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from bent_clip import bent_frames, capture

from splatwire.bitstream import packet_from_bytes, read_stream, write_stream
from splatwire.codec import decode_stream
from splatwire.ops.threads import use_single_thread
from splatwire.sequence import SequenceEncoder, SequenceOptions, decode_frames
from splatwire.sequence.live_decoder import LiveDecoder
from splatwire.transport.protocol.live_packager import LivePackager
from splatwire.types.splats import Splats

GROUP, LIVE_GROUP = 15, 8
DEGREE = 3


def clocks() -> tuple[float, float]:
    """Wall and processor time of this process, seconds."""
    return time.perf_counter(), time.process_time()


def swaying(count: int, frames: int) -> Iterator[Splats]:
    """Frames of a ball of Gaussians that sways."""
    rng = np.random.default_rng(1)
    means, quats, sizes = (rng.standard_normal((count, n), np.float32) for n in (3, 4, 3))
    means, quats = (rows / np.linalg.norm(rows, axis=1, keepdims=True) for rows in (means, quats))
    scales = np.exp(sizes * np.float32(0.3) - np.float32(4.5))
    opacities, sh = rng.random(count, np.float32) * np.float32(0.8) + np.float32(0.15), means[:, None] * np.float32(0.4)
    for frame in range(frames):
        sway = np.float32(0.2) * np.sin(np.float32(frame / 10) + means[:, 1:2]) * (means[:, :1] > 0)
        yield Splats(means + sway, quats, scales, opacities, sh)


def speed(path: Path, tracks: int, frames: int, threads: int) -> dict:
    """Frames per second of encoding, by wall and by processor time, and of decoding in one thread."""
    clip = list(bent_frames(capture(path, DEGREE, tracks), frames))
    for _ in range(2):  # kernels are loaded in the first
        encoder, taken = SequenceEncoder(SequenceOptions(group_frames=GROUP, threads=threads)), []
        for frame in clip:
            began = clocks()
            encoder.push(frame)
            taken.append([now - then for now, then in zip(clocks(), began, strict=True)])
        stream = encoder.finish()
    wall, processor = (sum(column) for column in zip(*taken[GROUP:], strict=True))
    use_single_thread()
    scene = decode_stream(stream, threads=1).scene
    began = clocks()
    shown = sum(1 for _ in decode_frames(scene))
    seconds = [now - then for now, then in zip(clocks(), began, strict=True)]
    rest = frames - GROUP
    return {
        "tracks": tracks, "frames": frames, "threads": threads, "bytes": stream.num_bytes,
        "encoding": {
            "frames_per_second": rest / wall, "frames_per_processor_second": rest / processor,
            "first_group_processor_s": sum(column[1] for column in taken[:GROUP]),
            "last_frame_of_a_group_s": [taken[n][0] for n in range(2 * GROUP - 1, frames, GROUP)],
        },
        "decoding": {"frames_per_second": shown / seconds[0], "frames_per_processor_second": shown / seconds[1]},
    }  # fmt: skip


def live(path: Path, tracks: int) -> dict:
    """Median processor time of each step from a group's last frame to its decoded frames, seconds.

    The first group does not count.
    """
    use_single_thread()
    encoder, decoder = SequenceEncoder(SequenceOptions(group_frames=LIVE_GROUP, threads=1), live=True), LiveDecoder()
    broadcast, steps = LivePackager(importance=encoder.importance), list[dict[str, float]]()
    for frame in bent_frames(capture(path, DEGREE, tracks), 6 * LIVE_GROUP):
        times = [time.process_time()]
        packets = encoder.push(frame)
        if not packets:
            continue
        times.append(time.process_time())
        manifest, side_info = encoder.current_header(1)
        edition = broadcast.add(manifest, side_info, packets)
        times.append(time.process_time())
        arrived = [packet_from_bytes(data, 1) for data in edition.packets[edition.newest_start :]]
        shown = [*decoder.update_header(manifest, side_info), *decoder.add(arrived[:-1])]
        times.append(time.process_time())
        frames = decoder.add(arrived[-1:])
        shown.append(next(frames))
        times.append(time.process_time())
        shown += frames
        times.append(time.process_time())
        if len(shown) != LIVE_GROUP:
            raise SystemExit("a group was not shown when all of it was there")
        names = ("encode", "publish", "decode_while_it_comes", "first_frame", "other_frames")
        steps.append({name: end - begin for name, (begin, end) in zip(names, itertools.pairwise(times), strict=True)})
    return {"tracks": tracks, **{name: statistics.median(step[name] for step in steps[1:]) for name in steps[0]}}


def encoded(tracks: int, frames: int, path: Path) -> None:
    """Encodes a clip to a file."""
    encoder = SequenceEncoder(SequenceOptions(group_frames=GROUP))
    for frame in swaying(tracks, frames):
        encoder.push(frame)
    write_stream(encoder.finish(), path)


def decoded(path: Path) -> None:
    """Decodes all frames of a file, one after another."""
    for _ in decode_frames(decode_stream(read_stream(path)[0]).scene):
        pass


def memory(tracks: int, lengths: list[int]) -> list[dict]:
    """Peak memory of encoding and decoding clips of some lengths."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for frames in lengths:
            path, row = Path(folder) / f"{frames}.swz", {"frames": frames, "tracks": tracks}
            for step in ("encode", "decode"):
                words = [
                    sys.executable,
                    __file__,
                    "--step",
                    step,
                    "--tracks",
                    str(tracks),
                    "--frames",
                    str(frames),
                    str(path),
                ]
                done = subprocess.run(words, capture_output=True, text=True, check=True)
                row[f"{step}_peak_bytes"] = json.loads(done.stdout)
            found.append({**row, "bytes": path.stat().st_size})
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, nargs="?")
    parser.add_argument("--tracks", type=int, default=50_000)
    parser.add_argument("--frames", type=int, default=45)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--live", action="store_true")
    parser.add_argument("--memory", type=int, nargs="+", help="frames of each clip")
    parser.add_argument("--step", choices=("encode", "decode"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.memory:
        print(json.dumps(memory(args.tracks, args.memory), indent=1))
    elif args.step:
        encoded(args.tracks, args.frames, args.capture) if args.step == "encode" else decoded(args.capture)
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
    elif args.live:
        print(json.dumps(live(args.capture, args.tracks), indent=1))
    else:
        print(json.dumps(speed(args.capture, args.tracks, args.frames, args.threads), indent=1))


if __name__ == "__main__":
    main()
