"""How fast clips are encoded and decoded, and what memory it takes: frames that are generated while they are pushed.

    python benchmarks/clip_speed.py CAPTURE [--tracks 50000] [--frames 45] [--threads 2]
    python benchmarks/clip_speed.py --memory 30 60 120 [--tracks 100000]

The capture is bent as `bent_clip.py` does. Wall and processor time are told side by side: on a machine that others use,
the second says more. The first group is apart: it looks at the scene from all sides and fits tables. With `--memory`
clips of so many frames, of a random ball that sways, each in a process of its own.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import torch
from bent_clip import bent_frames, capture

from splatwire.clips import ClipEncoder, ClipOptions, decode_frames
from splatwire.codec import decode_stream
from splatwire.packets import read_stream, write_stream
from splatwire.scene.splats import Splats

GROUP = 15
DEGREE = 3


def clocks() -> tuple[float, float]:
    """Wall and processor time of this process, seconds."""
    return time.perf_counter(), time.process_time()


def swaying(count: int, frames: int) -> Iterator[Splats]:
    """Frames of a ball of Gaussians that sways."""
    rng = torch.Generator().manual_seed(1)
    means = torch.nn.functional.normalize(torch.randn(count, 3, generator=rng), dim=1)
    quats = torch.nn.functional.normalize(torch.randn(count, 4, generator=rng), dim=1)
    scales = torch.exp(torch.randn(count, 3, generator=rng) * 0.3 - 4.5)
    opacities, sh = torch.rand(count, generator=rng) * 0.8 + 0.15, means[:, None] * 0.4
    for frame in range(frames):
        sway = 0.2 * torch.sin(frame / 10 + means[:, 1:2]) * (means[:, :1] > 0)
        yield Splats(means + sway, quats, scales, opacities, sh)


def speed(path: Path, tracks: int, frames: int, threads: int) -> dict:
    """Frames a second of encoding, by wall and by processor time, and of decoding in one thread."""
    clip = list(bent_frames(capture(path, DEGREE, tracks), frames))
    for _ in range(2):  # kernels are loaded in the first
        encoder, taken = ClipEncoder(ClipOptions(group_frames=GROUP, threads=threads)), []
        for frame in clip:
            began = clocks()
            encoder.push(frame)
            taken.append([now - then for now, then in zip(clocks(), began, strict=True)])
        stream = encoder.finish()
    wall, processor = (sum(column) for column in zip(*taken[GROUP:], strict=True))
    torch.set_num_threads(1)
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


def encoded(tracks: int, frames: int, path: Path) -> None:
    """Encodes a clip to a file."""
    encoder = ClipEncoder(ClipOptions(group_frames=GROUP))
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
    parser.add_argument("--memory", type=int, nargs="+", help="frames of each clip")
    parser.add_argument("--step", choices=("encode", "decode"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.memory:
        print(json.dumps(memory(args.tracks, args.memory), indent=1))
    elif args.step:
        encoded(args.tracks, args.frames, args.capture) if args.step == "encode" else decoded(args.capture)
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
    else:
        print(json.dumps(speed(args.capture, args.tracks, args.frames, args.threads), indent=1))


if __name__ == "__main__":
    main()
