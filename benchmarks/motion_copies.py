"""Gain of redundant copies of the motion that matters most, on clips that lose datagrams.

    python benchmarks/motion_copies.py monkey=FRAMES/ tztechno=FRAMES/ > benchmarks/results/motion_copies.json

Copies are simulated: the motion of the chosen tracks arrives in every group. `packets` chooses whole motion packets of
the greatest visible motion, up to a share of the stream's bytes. `tracks` chooses single tracks, the same share of all,
by size, opacity and the length of their path; their copies would take more than that share of the bytes.
"""

import argparse
import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.channel import parse_loss
from splatwire.channel.transmit import arrival_groups, draw_mask
from splatwire.codec import decode_stream
from splatwire.codec.sequence.known_tracks import visibility_of
from splatwire.evaluation.sequence.evaluation import available_by_group, frame_psnr
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.sequence import Frame, decode_frames, encode_sequence, frame_files, read_frames
from splatwire.sequence.importance import stream_importance
from splatwire.types import Cameras, SplatScene
from splatwire.types.sequence_scene import GroupMotion, SequenceScene


def best_packets(stream: SceneStream, share: float) -> np.ndarray:
    """Mask of the motion packets with the highest importance per byte, up to a share of the bytes, bool (P)."""
    importance = stream_importance(stream)
    sizes = np.array([len(packet.payload) for packet in stream.packets])
    worth = np.array([importance[packet.id] for packet in stream.packets]) / sizes
    order = np.argsort(-worth, kind="stable")
    chosen = np.zeros(len(sizes), bool)
    chosen[order[np.cumsum(sizes[order]) <= share * stream.num_bytes]] = True
    return chosen & (worth > 0)


def best_tracks(clip: SequenceScene, share: float) -> list[np.ndarray]:
    """Masks of the tracks with the longest visible path in each group, up to a share of the tracks, bool (T)."""
    visibility, found = visibility_of(clip.tracks.splats.scales, clip.tracks.splats.opacities), []
    everyone = np.ones(clip.num_gaussians, bool)
    for group in range(clip.timeline.num_groups):
        motion, length = clip.motion(group, everyone), np.zeros(clip.num_gaussians)
        positions = [motion.at(frame)[:, :3] for frame in range(len(clip.timeline.frames_of(group)))]
        for one, other in itertools.pairwise(positions):
            length[motion.tracks] += np.linalg.norm(other - one, axis=1)
        worth = visibility * length
        best = np.zeros(clip.num_gaussians, bool)
        best[np.argsort(-worth, kind="stable")[: round(share * len(motion.tracks))]] = True
        found.append(best & (worth > 0))
    return found


def with_tracks(clip: SequenceScene, complete: SequenceScene, copies: list[np.ndarray]) -> SequenceScene:
    """The received clip with the motion of the tracks `copies` added in each group."""

    def motion(group: int, available: np.ndarray) -> GroupMotion:
        part, full = clip.motion(group, available), complete.motion(group, available)
        kept = np.isin(full.tracks, part.tracks) | copies[group][full.tracks]
        names = ("tracks", "moving", "begins", "ends")
        return replace(
            part, **{name: getattr(full, name)[kept] for name in names}, at=lambda frame: full.at(frame)[kept],
            covered=part.covered | (copies[group] & available),
        )  # fmt: skip

    return replace(clip, motion=motion)


def psnr_of(clip: SequenceScene, frames: list[Frame], cameras: Cameras, available=None) -> float:
    """Mean PSNR from the second group of pictures on."""
    found = []
    for shown, frame in zip(decode_frames(clip, available=available), frames, strict=True):
        scenes = (shown.scene, frame.scene(clip.background))
        found.append(frame_psnr(*(np.stack(list(iterate_views(scene, cameras))) for scene in scenes)))
    later = clip.timeline.group_frames
    return float(np.mean(found[later if later < len(found) else 0 :]))


def measure(name: str, folder: Path, arguments: argparse.Namespace) -> dict:
    """Figures of one clip."""
    frames = list(read_frames(frame_files(folder)[: arguments.frames]))
    stream, tracking = encode_sequence(iter(frames))
    cameras = surrounding_cameras(SplatScene(frames[0].splats.select(frames[0].drawn)), arguments.views, 160)
    complete, loss = decode_stream(stream).scene, parse_loss(arguments.loss, "datagram")
    packets, tracks = best_packets(stream, arguments.share), best_tracks(complete, arguments.share)
    found: dict = {"name": name, "matched": tracking.matched_share, "complete": psnr_of(complete, frames, cameras)}
    for way in ("none", "packets", "tracks"):
        found[way] = []
        for seed in arguments.seeds:
            mask = draw_mask(stream, loss, seed=seed)
            when = arrival_groups(stream, mask, loss, seed=seed)
            if way == "packets":
                when = np.where(packets & (when < 0), 0, when)
            kept = (packet for packet, group in zip(stream.packets, when.tolist(), strict=True) if group >= 0)
            clip = decode_stream(stream.with_packets(kept)).scene
            if way == "tracks":
                clip = with_tracks(clip, complete, tracks)
            found[way].append(round(psnr_of(clip, frames, cameras, available_by_group(stream, when)), 3))
    return found


def main() -> None:
    """Measures clips."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", help="NAME=FOLDER")
    parser.add_argument("--loss", default="bernoulli:0.2")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--share", type=float, default=0.01)
    parser.add_argument("--frames", type=int, default=32)
    parser.add_argument("--views", type=int, default=2)
    arguments = parser.parse_args()
    named = [clip.partition("=")[::2] for clip in arguments.clips]
    print(json.dumps([measure(name, Path(folder), arguments) for name, folder in named], indent=1))


if __name__ == "__main__":
    main()
