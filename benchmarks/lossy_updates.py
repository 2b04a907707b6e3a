"""Updates of edits and of a watched training over a path that loses 20 % of the datagrams, and PSNR after an edit.

    cd $SPLATWIRE_DATA/splats
    python benchmarks/lossy_updates.py tandt_truck_opensplat_116k.splat > lossy_updates.json
    python benchmarks/lossy_updates.py guitar.compressed.ply --training
    python benchmarks/lossy_updates.py --draw docs/images/after_an_edit.webp

Server and receiver are the real ones, the path is simulated: 20 Mbit/s with a queue of 100 ms, 20 ms each way, losses
both ways. With feedback, the receiver requests missing packets. Without, repair symbols are sent ahead, and an update
with a missing packet at the end is requested again as a whole. Bytes are those of all datagrams to the receiver.

`edits`: a ball of 2 % of the Gaussians (`updates.py`). `curve` is the mean PSNR over several transfers at the times
`TIMES` after the request, in four views of the ball, against the edited scene: of the update, and of a transfer of the
whole scene that is shown when it is complete. `--draw` draws the stored curves. `training`: the simulated training of
`watched_training.py`, with its PSNR; the only part with `--training`. Encoding and applying are measured in processor
time and are not part of the times.
"""

import argparse
import heapq
import json
import random
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from updates import ball, edited
from watched_training import watched

from splatwire.bitstream import PRESETS, SceneStream
from splatwire.codec import apply_update, decode_stream, encode_scene, encode_update
from splatwire.io import open_scene
from splatwire.rate_control.partial_updates import SHARE
from splatwire.render import render_scene
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import scene_class_offsets
from splatwire.transport import Protection, Receiver, ReceiverOptions, make_served_stream
from splatwire.transport.protocol.sender import Server
from splatwire.types import Cameras, SplatScene
from splatwire.types.splats import Splats

RATE, QUEUE_S, DELAY_S, LOSSES = 2.5e6, 0.1, 0.02, (0.0, 0.2)
"""Bytes per second, longest wait in the queue and one-way delay in seconds, shares of lost datagrams."""
TIMES = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0)
TRANSFERS, VIEWS, SIZE = 3, 4, 192
AHEAD = Protection(init_repair=0.6, tier_repair=(0.6,))
"""Redundancy without feedback."""
MAX_REQUESTS = 20


def transfer(stream: SceneStream, loss: float, seed: int, feedback: bool) -> tuple[int, float, str]:
    """Simulates one transfer; returns bytes sent to the receiver, seconds, and reason of its end."""
    rng = random.Random(seed)
    served = make_served_stream(stream, None if feedback else AHEAD)
    server = Server({"scene": served}, secret=bytes(16), random=rng.randbytes)
    receiver = Receiver(rng.getrandbits(64), 0.0, ReceiverOptions(name="scene", nack=feedback))
    flying: list[tuple[float, int, bool, bytes]] = []
    now, free, sent = 0.0, 0.0, 0

    def send(data: bytes, down: bool) -> None:
        nonlocal free, sent
        begin = max(free, now) if down else now
        if down:
            sent += len(data)
            if begin - now > QUEUE_S:
                return
            free = begin = begin + len(data) / RATE
        if rng.random() >= loss:
            heapq.heappush(flying, (begin + DELAY_S, len(flying) + sent, down, data))

    while receiver.finished is None:
        times = (receiver.next_at(), server.next_at(), flying[0][0] if flying else None)
        now = max(now, min(at for at in times if at is not None))
        for _, data in server.poll(now):
            send(data, True)
        for data in receiver.poll(now)[0]:
            send(data, False)
        while flying and flying[0][0] <= now and receiver.finished is None:
            _, _, down, data = heapq.heappop(flying)
            if down:
                for reply in receiver.receive(data, now)[0]:
                    send(reply, False)
            elif (answer := server.receive("client", data, now)) is not None:
                send(answer, True)
    return sent, now, receiver.finished.reason


def delivered(stream: SceneStream, loss: float, seed: int, feedback: bool) -> tuple[int, float, int]:
    """Simulates transfers until the stream has arrived completely; returns bytes, seconds and number of requests."""
    num_bytes, seconds = 0, 0.0
    for request in range(1, MAX_REQUESTS + 1):
        sent, end, reason = transfer(stream, loss, 1000 * request + seed, feedback)
        num_bytes, seconds = num_bytes + sent, seconds + end
        if reason == "complete":
            return num_bytes, seconds, request
    raise SystemExit(f"a stream did not arrive in {MAX_REQUESTS} transfers")


def psnr(scene: Splats, cameras: Cameras, reference: np.ndarray) -> float:
    """PSNR of all views together, dB."""
    pictures = np.asarray(render_scene(SplatScene(scene), cameras), np.float64)
    return float(-10 * np.log10(max(np.mean((pictures - reference) ** 2), 1e-10)))


def curve(seconds: list[float], before: float, after: float) -> list[float]:
    """Mean PSNR at `TIMES`, if the picture changes from `before` to `after` at the given seconds."""
    return [round(float(np.mean([after if time >= end else before for end in seconds])), 2) for time in TIMES]


def edits(scene: SplatScene) -> list[dict[str, object]]:
    """Rows of all edits."""
    stream = encode_scene(scene, PRESETS["datagram"], class_offsets=scene_class_offsets(scene))
    base, rows = decode_stream(stream).scene, []
    precision = base.coding.precision_classes.astype(np.int64) - int(base.coding.precision_classes.max())
    centre = int(np.random.default_rng(0).integers(scene.num_elements))
    chosen, radius = ball(base, centre)
    cameras = surrounding_cameras(SplatScene(base.splats.select(chosen)), VIEWS, SIZE)
    for edit in ("deleted", "moved", "recoloured"):
        kept = np.setdiff1d(np.arange(base.num_elements), chosen) if edit == "deleted" else np.arange(base.num_elements)
        after = edited(base, chosen, radius, edit).select(kept)
        began = time.process_time()
        update = encode_update(stream, after, class_offsets=precision[kept])
        encoded = time.process_time()
        changed = apply_update(stream, update)
        applied = time.process_time()
        reference = np.asarray(render_scene(SplatScene(after.splats), cameras), np.float64)
        first, last = (psnr(one, cameras, reference) for one in (base.splats, decode_stream(changed).scene.splats))
        for loss in LOSSES:
            for feedback in (True, False):
                found = {
                    name: [delivered(each, loss, seed, feedback) for seed in range(TRANSFERS)]
                    for name, each in (("update", update), ("whole", changed))
                }
                row: dict[str, object] = {
                    "edit": edit, "loss": loss, "feedback": feedback, "scene_bytes": changed.num_bytes,
                    "update_bytes": update.num_bytes, "encode_cpu_s": round(encoded - began, 2),
                    "apply_cpu_s": round(applied - encoded, 2),
                    "before_db": round(first, 2), "after_db": round(last, 2),
                }  # fmt: skip
                for name, transfers in found.items():
                    seconds = [one[1] for one in transfers]
                    row[name] = {
                        "sent_ratio": round(float(np.mean([one[0] for one in transfers])) / changed.num_bytes, 4),
                        "seconds": [round(one, 3) for one in seconds], "requests": [one[2] for one in transfers],
                        "curve": curve(seconds, first, last),
                    }  # fmt: skip
                rows.append(row)
    return rows


def training(target: Splats) -> list[dict[str, object]]:
    """Rows of a watched training."""
    rows = []
    for row, update in watched(target, SHARE):
        for feedback in (True, False):
            found = [delivered(update, 0.2, seed, feedback) for seed in range(TRANSFERS)]
            row["feedback" if feedback else "ahead"] = {
                "sent_ratio": round(float(np.mean([one[0] for one in found])) / row["spz_bytes"], 4),
                "seconds": round(max(one[1] for one in found), 3), "requests": max(one[2] for one in found),
            }  # fmt: skip
        rows.append(row)
    return rows


def draw(path: Path) -> None:
    """Draws PSNR over the time after an edit, from the stored results."""
    from matplotlib import pyplot

    results = Path(__file__).parent / "results" / "lossy_updates.json"
    edits = [row for row in json.loads(results.read_text())["edits"] if row["feedback"]]
    names = list(dict.fromkeys(row["edit"] for row in edits))
    figure, axes = pyplot.subplots(1, len(names), figsize=(9, 3.4), squeeze=False, layout="constrained")
    for axis, name in zip(axes[0], names, strict=True):
        for row in (row for row in edits if row["edit"] == name):
            for sent, title, line in (("update", "update", "-"), ("whole", "whole scene", "--")):
                label = f"{title}, {100 * row['loss']:.0f} % lost"
                color = "C1" if row["loss"] else "C0"
                axis.plot(TIMES, row[sent]["curve"], line, color=color, drawstyle="steps-post", label=label)
        axis.set_title(f"a {name} ball", fontsize=9)
        axis.set_xlabel("seconds after the request")
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("mean PSNR, dB")
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    figure.savefig(path, dpi=90)


def main() -> None:
    """Measures edits and training."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, nargs="?")
    parser.add_argument("--training", action="store_true")
    parser.add_argument("--draw", type=Path, help="path of a picture of the stored results; nothing is measured")
    args = parser.parse_args()
    if args.draw:
        draw(args.draw)
        return
    if args.scene is None:
        parser.error("a scene is missing")
    scene = open_scene(args.scene)
    assert isinstance(scene, SplatScene)
    scene = replace(scene.select(scene.drawable), coding=None)
    found = {} if args.training else {"times": TIMES, "edits": edits(scene)}
    print(json.dumps({**found, "training": training(scene.splats)}, indent=1))


if __name__ == "__main__":
    main()
