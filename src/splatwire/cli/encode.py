"""Options of `splatwire encode`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from splatwire.cli._options import BackgroundOption, JsonFlag


@dataclass(frozen=True)
class Encode:
    """Encode a scene into a stream of independently decodable packets."""

    scene: tyro.conf.Positional[str]
    """Scene file, or explicit Gaussians: PLY, compressed PLY, SPZ, SOG, .splat, .ksplat, .glb; - for standard input. A
    .splatv file, or a folder with one such file per frame, becomes a clip."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Stream to write: one file if the name ends in .swz (or is -), otherwise a folder of packets."""
    preset: str | None = None
    """Packetization preset: spread (lanes over blocks as large as possible), paper, datagram or hacpp. Default: spread
    for anchors; paper for Gaussians, and if --block-size or --lanes is given."""
    block_size: int | None = None
    """Maximum number of elements in a spatial block."""
    lanes: int | None = None
    """Number of packets into which a block is split."""
    tiers: tuple[float, ...] = ()
    """Importance tiers with separate packets: shares of the elements, most important tier first, e.g. 0.05 or 0.05
    0.15."""
    levels: Literal["auto", "none"] | None = None
    """auto: add levels of detail, coarser Gaussians that replace distant or lost ones, for scenes larger than a view.
    none: no levels. Default: auto for a streamed SOG, whose finest level is read, otherwise none."""
    keep: float = 1.0
    """Share of the elements to keep. 0.6 removes the 40 % that contribute least to the pictures, and prints the loss of
    quality."""
    data: Path | None = None
    """Folder with photos and poses. Importance is measured in its training cameras, and a page begins with the first of
    them. Default: views around the scene."""
    cameras: Path | None = None
    """Cameras file, used in the same way as the cameras of --data."""
    no_sketch: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """With --preset datagram: leave out the redundant copies of the most important Gaussians. They take 1 % of the
    bytes, are used by --conceal sketch, and gain about 2 dB if packets are lost."""
    up: Literal["auto", "y", "-y", "z", "-z"] = "auto"
    """Up axis, for pages. auto: from the cameras, otherwise that of the file's metadata. Without either:
    -y, as in files of Gaussians, or y if Gaussians are clearly brighter seen from +y (in a flat scene: reach clearly
    farther to +y)."""
    refine: int = 0
    """Steps of refitting the context model before encoding; 600 steps take one to two minutes and save a few percent of
    the bytes. `train` refits by default; a decoded scene, or one imported from HAC++, loses 0.1 dB."""
    quality: str | None = None
    """Quantisation quality of explicit Gaussians, 0 (smallest) to 100 (finest), or a name: small (40), default (60) or
    near-lossless (85)."""
    size: str | None = None
    """Explicit Gaussians: maximum size of the stream, such as 500kB or 0.5MB; at least 97 % of it are used."""
    psnr: float | None = None
    """Explicit Gaussians: mean PSNR against pictures of the source, decibels, usually reached within 0.2 dB. The PSNR
    that was reached is printed."""
    effort: Literal["fast", "default", "best"] | None = None
    """fast: keep all Gaussians (see also --keep). default: also remove those that pictures of the scene do not need, as
    many as the quality permits; fewer bytes at equal quality. best: remove more, and fine-tune the others to pictures
    of the scene; takes minutes. Without this option: default if --size or --psnr is given, otherwise fast."""
    loss: str | None = None
    """With --effort best: loss model of the channel, such as bernoulli:0.2. Fine-tuning then simulates lost packets
    (lost datagrams with --preset datagram), so that the received Gaussians cover the lost ones."""
    seed: int | None = None
    """With --effort best: random seed of the fine-tuning, default 0."""
    update: str | None = None
    """Stream of the scene before it was changed: a .swz file or a folder. Writes an update, which has only the changes;
    `apply` makes the changed stream of both. Quantisation, packets and metadata are those of the stream."""
    background: BackgroundOption = None
    """Background colour to store in the stream, RGB from 0 to 1. Default: that of the scene file."""
    fps: float | None = None
    """Clips: frames per second, default 30."""
    group: int | None = None
    """Clips: length of a group of frames (GOP), 1 to 64 frames, default 15. A lost motion packet affects one group."""
    frames: int | None = None
    """.splatv files: number of frames to sample, default 50."""
    json: JsonFlag = False
    """Print one JSON object."""
