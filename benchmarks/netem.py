"""The bundled scene from `splatwire serve` to `splatwire receive` over links that Linux loses datagrams on (tc netem).

    python benchmarks/netem.py [--views 4]         # under a user-mode kernel: benchmarks/with_netem.sh
    python benchmarks/netem.py --here              # as root of a kernel that has netem

Prints one JSON object. Server and receiver are processes in network namespaces of their own, joined by a veth pair with
netem on both ends: requests and feedback are lost like packets. The loss is what tc's counters say of each end. What
arrived is drawn and scored against pictures of the whole scene. netem takes no seed before Linux 6.6: no two runs are
alike.
"""

import argparse
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ASSETS = HERE.parent / "src" / "splatwire" / "assets"
SERVER, CLIENT = "10.73.0.1", "10.73.0.2"
LINKS = {
    "random": "delay 10ms loss random 20%",
    "bursts of 20": "delay 10ms loss gemodel 1.25% 5% 100% 0%",
    "disordered": "delay 30ms 10ms distribution normal loss random 20% duplicate 2% reorder 5% 50%",
    "1 Mbit/s": "delay 10ms rate 1mbit loss random 20%",
}
CROSSINGS = [
    ("udp", "random", (), ("--no-nack", "--partial")),
    ("udp", "random", (), ()),
    ("udp", "bursts of 20", (), ("--no-nack", "--partial")),
    ("udp", "bursts of 20", (), ()),
    ("udp", "disordered", (), ("--no-nack", "--partial")),
    ("udp", "disordered", (), ()),
    ("udp", "1 Mbit/s", ("--side-repair", "0.5"), ("--no-nack", "--partial", "--deadline", "5s")),
    ("quic", "random", (), ("--no-nack", "--partial")),
    ("quic", "bursts of 20", (), ("--no-nack", "--partial")),
    ("udp", "random", (), ("--no-nack", "--partial", "--deadline", "5s", "--conceal", "grow")),
]
"""Scheme, link, options of `splatwire serve` and of `splatwire receive`."""


def told(*words: str) -> str:
    return subprocess.run(words, check=True, capture_output=True, text=True, timeout=30).stdout


@contextlib.contextmanager
def link(netem: str) -> Iterator[tuple[str, str]]:
    """Two fresh namespaces, joined by a lossy cable.

    Args:
        netem: Both ends' options of tc netem.

    Yields:
        The server's and the client's namespace.
    """
    names = f"server-{os.getpid()}", f"client-{os.getpid()}"
    try:
        for name in names:
            told("ip", "netns", "add", name)
        told("ip", "-n", names[0], "link", "add", "cable", "type", "veth", "peer", "name", "cable", "netns", names[1])
        for name, address in zip(names, (SERVER, CLIENT), strict=True):
            told("ip", "-n", name, "address", "add", f"{address}/24", "dev", "cable")
            told("ip", "-n", name, "link", "set", "cable", "up")
            told("tc", "-n", name, "qdisc", "add", "dev", "cable", "root", "netem", "limit", "100000", *netem.split())
        yield names
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "del", name], check=False, timeout=30)


def counters(namespace: str) -> dict[str, float]:
    """What tc says that netem passed on, in frames with their headers, holds and lost."""
    (facts,) = json.loads(told("tc", "-n", namespace, "-s", "-j", "qdisc", "show", "dev", "cable"))
    offered = facts["packets"] + facts["qlen"] + facts["drops"]
    return {"passed": facts["packets"], "bytes_passed": facts["bytes"], "waiting": facts["qlen"],
            "lost": facts["drops"], "percent_lost": round(100 * facts["drops"] / max(1, offered), 2)}  # fmt: skip


def overflows(namespace: str) -> int:
    """Datagrams that came and found the buffer of their socket full."""
    names, values = re.findall(r"^Udp: (.*)$", told("ip", "netns", "exec", namespace, "cat", "/proc/net/snmp"), re.M)
    return int(dict(zip(names.split(), values.split(), strict=True))["RcvbufErrors"])


def splatwire(namespace: str, *words: str) -> list[str]:
    return ["ip", "netns", "exec", namespace, sys.executable, "-m", "splatwire", *words, "--json"]


@contextlib.contextmanager
def serving(namespace: str, stream: Path, words: tuple[str, ...], log: Path) -> Iterator[dict[str, Any]]:
    """A server; gives what it says of itself, and writes its last words to a file."""
    command = splatwire(namespace, "serve", str(stream), "--host", SERVER, "--port", "0", *words)
    with log.open("w") as errors, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as server:
        assert server.stdout is not None
        try:
            yield json.loads(server.stdout.readline())
            server.send_signal(signal.SIGINT)
            server.wait(20)
        finally:
            server.kill()


def cross(folder: Path, number: int) -> dict[str, Any]:
    """One transfer; what arrived is `NUMBER.swz`, or `NUMBER.safetensors` where it was concealed."""
    scheme, path, serve, options = CROSSINGS[number]
    serve = (*serve, *("--quic",) * (scheme == "quic"))
    target = folder / f"{number}.{'safetensors' if '--conceal' in options else 'swz'}"
    log = folder / f"{number}.log"
    with link(LINKS[path]) as (server, client):
        with serving(server, folder / "scene.swz", serve, log) as facts:
            pinned = ("--fingerprint", facts["fingerprint"]) if scheme == "quic" else ()
            url = f"{scheme}://{SERVER}:{facts['port']}"
            command = splatwire(client, "receive", url, "-o", str(target), *options, *pinned)
            began = time.monotonic()
            received = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, timeout=200).stdout)
            lasted = time.monotonic() - began
        seen = {"to_client": counters(server), "to_server": counters(client)}
        full = overflows(server), overflows(client)
    packets = received["packets"]
    return {
        "serve": " ".join(["splatwire serve scene.swz", *serve]),
        "receive": " ".join(["splatwire receive", f"{scheme}://HOST:PORT", "-o", target.name, *options]),
        "netem": LINKS[path],
        "output": target.name,
        "finished": received["finished"],
        "packets": f"{packets['num_expected'] - packets['num_missing']} of {packets['num_expected']}",
        "seconds": round(received["seconds"], 2),
        "seconds_to_side_info": round(received["seconds_to_side_info"], 2),
        "seconds_of_the_command": round(lasted, 2),
        "bytes_sent": int(re.findall(r"([\d,]+) bytes", log.read_text())[-1].replace(",", "")),
        "bytes_received": received["bytes_received"],
        "datagrams_rejected": received["datagrams_rejected"],
        "lost_in_a_full_socket": {"client": full[1], "server": full[0]},
        "tc": seen,
    }


def cross_all(folder: Path) -> None:
    """All transfers, told in `crossings.json`; for the kernel that has netem."""
    rows = []
    for number in range(len(CROSSINGS)):
        rows.append(cross(folder, number))
        print(json.dumps(rows[-1]), file=sys.stderr)
    (folder / "crossings.json").write_text(json.dumps({"kernel": " ".join(os.uname()[::2]), "crossings": rows}))


def prepare(folder: Path) -> None:
    """Writes the bundled scene as the stream `scene.swz` of datagrams."""
    from splatwire.codec import decode_stream, encode_scene
    from splatwire.packets import PRESETS, read_stream, write_stream

    bundled = decode_stream(read_stream(ASSETS / "snowmiku.swz")[0]).scene
    write_stream(encode_scene(bundled, PRESETS["datagram"]), folder / "scene.swz")


def score(folder: Path, rows: list[dict[str, Any]], num_views: int) -> None:
    """Draws what arrived and writes its PSNR against pictures of the whole scene into the rows."""
    from splatwire.codec import decode_stream
    from splatwire.conceal import conceal, create_concealer
    from splatwire.data import load_cameras
    from splatwire.metrics import psnr
    from splatwire.model.scene_file import load_scene_file
    from splatwire.packets import read_stream
    from splatwire.render import render_scene

    cameras = load_cameras(ASSETS / "snowmiku_cameras.json")
    cameras = cameras.select([view * cameras.num_views // num_views for view in range(num_views)])
    truth = render_scene(decode_stream(read_stream(folder / "scene.swz")[0]).scene, cameras)
    sent = (folder / "scene.swz").read_bytes()
    for row in rows:
        path = folder / row["output"]
        row["every_byte"] = path.read_bytes() == sent
        if path.suffix == ".swz":
            partial = decode_stream(read_stream(path)[0])
            names = () if row["every_byte"] else ("drop", "grow")
            scenes = {name: conceal(partial, create_concealer(name)) for name in names}
        else:
            scenes = {"as written": load_scene_file(path)[0]}
        row["psnr"] = {name: round(float(psnr(render_scene(scene, cameras), truth).mean()), 2)
                       for name, scene in scenes.items()}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--here", action="store_true")
    parser.add_argument("--cross", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.cross:
        cross_all(arguments.cross)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        command = [sys.executable, __file__, "--cross", name]
        if not arguments.here:
            command = [str(HERE / "with_netem.sh"), "-w", name, "-t", "900", *command]
        subprocess.run(command, check=True)
        told_there = {"stream_bytes": (folder / "scene.swz").stat().st_size}
        told_there |= json.loads((folder / "crossings.json").read_text())
        score(folder, told_there["crossings"], arguments.views)
    print(json.dumps({"load_average": os.getloadavg(), "views": arguments.views, **told_there}, indent=1))


if __name__ == "__main__":
    main()
