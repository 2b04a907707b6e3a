"""Clips against other formats of sequences: SPZ files, one SPZ of all frames, and .4dgs of PyPI's `fourdgs`.

    pip install fourdgs==0.6.0
    python benchmarks/clip_formats.py guitar=FRAMES/ [--fps 30]      # a folder of PLY whose rows keep their Gaussian

PSNR: every tenth frame, two views, against its own file. `.4dgs` has two rows: its command `convert`, and its model of
key frames and deltas with rows as identities, for which error bounds replace the PSNR.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from splatwire.codec import decode_stream
from splatwire.io.formats import read_splats, write_splats
from splatwire.metrics import psnr
from splatwire.ops.spherical_harmonics import DC
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.sequence import SequenceOptions, decode_frames, encode_sequence, frame_files, read_frames
from splatwire.types import Cameras, SplatScene
from splatwire.types.splats import Splats

EVERY, PIXELS = 10, 320


def score(shown: list[Splats], files: list[Path], cameras: Cameras) -> float:
    """Mean PSNR of some frames against their files."""
    found = []
    for splats, path in zip(shown, files, strict=True):
        pairs = (iterate_views(SplatScene(some), cameras) for some in (splats, read_splats(path)))
        found += [float(psnr(ours[None], theirs[None])[0]) for ours, theirs in zip(*pairs, strict=True)]
    return float(np.mean(found))


def of_clip(files: list[Path], cameras: Cameras, quality: str) -> dict:
    """The clip of splatwire."""
    stream, _ = encode_sequence(read_frames(files), SequenceOptions(quality=quality))
    shown = [frame.scene.drawn() for frame in decode_frames(decode_stream(stream).scene) if frame.number % EVERY == 0]
    return {"bytes": stream.num_bytes, "psnr": score(shown, files[::EVERY], cameras)}


def of_spz(files: list[Path], folder: Path, cameras: Cameras) -> dict:
    """A file a frame, and all frames in one."""
    for number, path in enumerate(files):
        write_splats([read_splats(path)], folder / f"{number:03}.spz")
    made = sorted(folder.glob("*.spz"))
    write_splats((read_splats(path) for path in files), folder / "all.spz")
    return {
        "bytes": sum(path.stat().st_size for path in made), "bytes_in_one": (folder / "all.spz").stat().st_size,
        "psnr": score([read_splats(path) for path in made[::EVERY]], files[::EVERY], cameras),
    }  # fmt: skip


def of_fourdgs(files: list[Path], folder: Path, cameras: Cameras, fps: float) -> dict:
    """`.4dgs` by `convert`, and with key frames and deltas."""
    import fourdgs
    from fourdgs.convert import convert_ply_sequence
    from fourdgs.keyframe_delta_file import write_sequence
    from fourdgs.keyframe_delta_writer import Sample

    gaussians, seconds = convert_ply_sequence(str(files[0].parent), fps=fps)
    fourdgs.write(str(folder / "clip.4dgs"), gaussians, seconds)
    scene = fourdgs.read(str(folder / "clip.4dgs")).gaussians
    shown = []
    for number in range(0, len(files), EVERY):
        state = scene.state_at((number + 0.5) / fps)
        index = state["indices"]
        colours = (scene.colors[index, :3] - np.float32(0.5)) / np.float32(DC)
        shown.append(Splats(
            state["centers"].astype(np.float32), scene.rotations[index][:, [3, 0, 1, 2]],
            scene.scales[index], np.clip(state["opacity"], 1e-6, 1 - 1e-6).astype(np.float32),
            colours[:, None],
        ))  # fmt: skip
    which = np.rint(gaussians.win_lo * fps).astype(int)
    samples = []
    for number in range(len(files)):
        own = {
            name: values[which == number] if isinstance(values, np.ndarray) else values
            for name, values in vars(gaussians).items()
        }
        count = len(own["positions"])
        own |= {
            "motions": np.zeros((count, 3), np.float32), "sigma_t": np.full(count, 100 * seconds, np.float32),
            "mu_t": np.zeros(count, np.float32), "win_lo": np.zeros(count), "win_hi": np.full(count, seconds),
        }  # fmt: skip
        samples.append(Sample(number / fps, np.arange(count), fourdgs.GaussianSet(**own)))
    deltas = write_sequence(samples, seconds)
    psnr_ = score(shown, files[::EVERY], cameras)
    return {"bytes": (folder / "clip.4dgs").stat().st_size, "psnr": psnr_, "bytes_of_deltas": len(deltas)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", help="NAME=FOLDER")
    parser.add_argument("--fps", type=float, default=30.0)
    arguments = parser.parse_args()
    found = []
    for name, _, source in (clip.partition("=") for clip in arguments.clips):
        files = frame_files(source)
        first = read_splats(files[0])
        cameras = surrounding_cameras(SplatScene(first), 2, PIXELS)
        with tempfile.TemporaryDirectory() as folder:
            formats = {
                "splatwire": of_clip(files, cameras, "default"),
                "splatwire_near_lossless": of_clip(files, cameras, "near-lossless"),
                "spz": of_spz(files, Path(folder), cameras),
                "fourdgs": of_fourdgs(files, Path(folder), cameras, arguments.fps),
            }
        found.append({"name": name, "frames": len(files), "gaussians": first.num_gaussians, "formats": formats})
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
