"""Clips against other formats of sequences: SPZ files, one SPZ of all frames, .4dgs of PyPI's `fourdgs`, .splat4d.

    pip install fourdgs==0.6.0 splats4d==0.1.0
    python benchmarks/clip_formats.py guitar=FRAMES/ [--fps 30] [--formats splatwire splat4d]

PSNR: every tenth frame, two views, against its own file. `.4dgs` has two rows: its command `convert`, and its model of
key frames and deltas with rows as identities; it has error bounds instead of a PSNR. `.splat4d` is written with
several error bounds. `ratio`: bytes of splatwire over those of another format at the PSNR of that format, interpolated
between qualities in decibels and logarithms of bytes.
"""

import argparse
import json
import math
import subprocess
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
FORMATS = ("splatwire", "spz", "fourdgs", "splat4d")
LEVELS = ("small", "default", "near-lossless")
BOUNDS = ((0.25, 1, 0, 0.5), (0.5, 2, 0, 1), (1, 4, 0, 2), (2, 6, 1, 4), (4, 10, 2, 8))
"""Error bounds of `.splat4d`: position in thousandths of the extent times `CELL`, colour in levels, rotation in steps,
scale in per cent."""
CELL = 0.25


def score(shown: list[Splats], files: list[Path], cameras: Cameras) -> float:
    """Mean PSNR of some frames against their files."""
    found = []
    for splats, path in zip(shown, files, strict=True):
        pairs = (iterate_views(SplatScene(some), cameras) for some in (splats, read_splats(path)))
        found += [float(psnr(ours[None], theirs[None])[0]) for ours, theirs in zip(*pairs, strict=True)]
    return float(np.mean(found))


def of_clip(files: list[Path], cameras: Cameras, quality: str) -> dict:
    """Encodes a clip with splatwire; returns bytes and PSNR."""
    stream, _ = encode_sequence(read_frames(files), SequenceOptions(quality=quality))
    shown = [frame.scene.drawn() for frame in decode_frames(decode_stream(stream).scene) if frame.number % EVERY == 0]
    return {"bytes": stream.num_bytes, "psnr": score(shown, files[::EVERY], cameras)}


def of_spz(files: list[Path], folder: Path, cameras: Cameras) -> dict:
    """Bytes and PSNR of one SPZ file for each frame, and of all frames in one file."""
    for number, path in enumerate(files):
        write_splats([read_splats(path)], folder / f"{number:03}.spz")
    made = sorted(folder.glob("*.spz"))
    write_splats((read_splats(path) for path in files), folder / "all.spz")
    return {
        "bytes": sum(path.stat().st_size for path in made), "bytes_in_one": (folder / "all.spz").stat().st_size,
        "psnr": score([read_splats(path) for path in made[::EVERY]], files[::EVERY], cameras),
    }  # fmt: skip


def of_fourdgs(files: list[Path], folder: Path, cameras: Cameras, fps: float) -> dict:
    """Bytes and PSNR of `.4dgs`, made by `convert`, and with key frames and deltas."""
    import fourdgs
    from fourdgs.convert import convert_ply_sequence
    from fourdgs.keyframe_delta_file import write_sequence
    from fourdgs.keyframe_delta_writer import Sample

    frames = folder / "ply"
    frames.mkdir()
    for number, path in enumerate(files):
        write_splats([read_splats(path)], frames / f"frame_{number:04d}.ply")
    gaussians, seconds = convert_ply_sequence(str(frames), fps=fps)
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


def of_splat4d(files: list[Path], folder: Path, cameras: Cameras, fps: float) -> list[dict]:
    """Bytes and PSNR of `.splat4d` at several error bounds; the third row has the defaults except for positions."""
    frames, found = folder / "splats", []
    frames.mkdir()
    for number, path in enumerate(files):
        write_splats([read_splats(path)], frames / f"frame_{number:04d}.splat")
    low, high = np.quantile(read_splats(files[0]).means, [0.02, 0.98], axis=0)
    extent = float((high - low).max())
    for place, colour, rotation, scale in BOUNDS:
        target = folder / "clip.splat4d"
        command = ["splat4d", "encode", "-i", str(frames), "-o", str(target), "--no-verify", "--fps", str(fps)]
        bounds = {"pos-mm": CELL * extent * place, "color-levels": colour, "rot-steps": rotation, "scale-pct": scale}
        command += [word for name, value in bounds.items() for word in (f"--{name}", f"{value:g}")]
        subprocess.run([*command, "--zstd-level", "19"], check=True, capture_output=True)
        shown = []
        for number in range(0, len(files), EVERY):
            frame = folder / "frame.splat"
            subprocess.run(
                ["splat4d", "decode", str(target), "--frame", str(number), "-o", str(frame)],
                check=True, capture_output=True,
            )  # fmt: skip
            shown.append(read_splats(frame))
        psnr_ = score(shown, files[::EVERY], cameras)
        found.append({"bounds": bounds, "bytes": target.stat().st_size, "psnr": psnr_})
    return found


def bytes_at(ours: list[dict], decibels: float) -> float | None:
    """Bytes of splatwire at a PSNR between those of its qualities; None outside of their range."""
    order = sorted(ours, key=lambda one: one["psnr"])
    if not order[0]["psnr"] <= decibels <= order[-1]["psnr"]:
        return None
    logs = [math.log(one["bytes"]) for one in order]
    return math.exp(float(np.interp(decibels, [one["psnr"] for one in order], logs)))


def measure(source: Path, folder: Path, fps: float, wanted: list[str]) -> dict:
    """Measures a clip in all formats."""
    files = frame_files(source)
    first = read_splats(files[0])
    cameras = surrounding_cameras(SplatScene(first), 2, PIXELS)
    ours = [{"quality": level, **of_clip(files, cameras, level)} for level in LEVELS]
    formats: dict = {"splatwire": ours}
    if "spz" in wanted:
        formats["spz"] = of_spz(files, folder, cameras)
    if "fourdgs" in wanted:
        formats["fourdgs"] = of_fourdgs(files, folder, cameras, fps)
    if "splat4d" in wanted:
        formats["splat4d"] = of_splat4d(files, folder, cameras, fps)
    for some in list(formats.values())[1:]:
        for one in some if isinstance(some, list) else [some]:
            own = bytes_at(ours, one["psnr"])
            one["ratio"] = own and own / one["bytes"]
    return {"frames": len(files), "gaussians": first.num_gaussians, "formats": formats}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", help="NAME=FOLDER")
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--formats", nargs="+", choices=FORMATS, default=FORMATS)
    arguments = parser.parse_args()
    found = []
    for name, _, source in (clip.partition("=") for clip in arguments.clips):
        with tempfile.TemporaryDirectory() as folder:
            found.append({"name": name, **measure(Path(source), Path(folder), arguments.fps, arguments.formats)})
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
