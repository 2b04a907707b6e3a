"""Live clips: from the last frame of a group, written, to that group's frames, written by the receiver, over loopback.

    python benchmarks/live_latency.py FRAMES/ [--group 8] [--fps 30] [--loss 0.2] [--rounds 3]

`splatwire live -` and `splatwire receive` run as processes of their own; with `--loss` the test suite's relay between
them drops datagrams. Both share this machine, and the receiver writes a PLY a frame.
"""

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from splatwire.clips import frame_files


def started(*words: object, **options: object) -> subprocess.Popen:
    """A process of this interpreter, its output as text."""
    return subprocess.Popen([sys.executable, *map(str, words)], stdout=subprocess.PIPE, text=True, **options)


def watched(server: subprocess.Popen, port: int, files: list[Path], target: Path, args: argparse.Namespace) -> dict:
    """Feeds names of files at their rate; when each group was whole, and when its last frame was there to read."""
    client = started("-m", "splatwire", "receive", f"udp://127.0.0.1:{port}", "-o", target, "--json")
    pushed: dict[int, float] = {}
    begin = None
    for number, path in enumerate(files):
        if begin is not None:
            time.sleep(max(begin + (number - args.group) / args.fps - time.time(), 0.0))
        server.stdin.write(f"{path}\n")
        server.stdin.flush()
        pushed[number] = time.time()
        if number == args.group - 1:  # what follows keeps time: the first group takes the compiling of kernels, too
            while not (target / f"frame_{number:06}.ply").exists():
                time.sleep(0.01)
            begin = time.time()
    server.stdin.close()
    out, _ = client.communicate(timeout=120)
    groups = range(2 * args.group - 1, len(files) - len(files) % args.group, args.group)
    shown = {n: (target / f"frame_{n:06}.ply").stat().st_mtime for n in groups}
    return {"latency_s": [shown[n] - pushed[n] for n in groups], "receiver": json.loads(out)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--group", type=int, default=8)
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--rate", type=float, help="of `live`: megabits per second, fixed")
    parser.add_argument("--rounds", type=int, default=3, help="how often the frames are played, there and back")
    args = parser.parse_args()
    once = frame_files(args.frames)
    files = [path for number in range(args.rounds) for path in (once if number % 2 == 0 else once[::-1])]
    words = ("-m", "splatwire", "live", "-", "--port", 0, "--group", args.group, "--fps", args.fps, "--json")
    words += () if args.rate is None else ("--rate", args.rate)
    relay = None
    with tempfile.TemporaryDirectory() as folder, started(*words, stdin=subprocess.PIPE) as server:
        try:
            port = json.loads(server.stdout.readline())["port"]
            if args.loss:
                relay = started("tests/transport/relay.py", "--server", port, "--port", 4861, "--loss", args.loss)
                time.sleep(1.0)
                port = 4861
            found = watched(server, port, files, Path(folder) / "out", args)
        finally:
            os.kill(server.pid, signal.SIGINT)
            if relay:
                relay.kill()
                relay.wait()
                relay.stdout.close()
    late = found["latency_s"]
    print(json.dumps({
        "frames": str(args.frames), "group": args.group, "fps": args.fps, "loss": args.loss, "groups": len(late),
        "latency_s": {"median": statistics.median(late), "worst": max(late)},
        "datagrams": found["receiver"]["datagrams_received"], "packets": found["receiver"]["packets"],
    }, indent=1))  # fmt: skip


if __name__ == "__main__":
    main()
