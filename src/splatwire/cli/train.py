"""Options of `splatwire train`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from splatwire.cli._options import BackgroundOption, JsonFlag


@dataclass(frozen=True)
class Train:
    """Train a scene from a folder of posed photos (COLMAP, BungeeNeRF, Blender or nerfstudio layout)."""

    data: tyro.conf.Positional[str]
    """Dataset folder; or a transforms.json in it, which is then read instead of a COLMAP reconstruction beside it."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Scene file to write; checkpoints are written to the same name with .checkpoint added. With --model gaussians: a
    PLY or another file of explicit Gaussians, or a stream (.swz)."""
    preset: str = "auto"
    """Preset: mipnerf360, tanks_and_temples, deep_blending, bungeenerf or synthetic_nerf; auto chooses by the layout of
    the data."""
    model: str | None = None
    """causal (anchors, format 2), hacpp (anchors, format 1: larger streams, as used by the paper's interpolation and
    network) or gaussians (explicit Gaussians, for every player). Default: causal; a finished scene keeps its model."""
    gaussians: int | None = None
    """With --model gaussians: number of Gaussians, default 100000. Bytes and time are about proportional to it."""
    degree: int | None = None
    """With --model gaussians: degree of the spherical harmonics, 0 to 3, default 3."""
    quality: str | None = None
    """With --model gaussians: quantisation quality of the stream, as in `encode`. The last part of the training adapts
    the Gaussians to it. Default: default."""
    lmbda: float | None = None
    """Weight of the rate (lambda); larger values give smaller scenes. Default: with --model causal 0.008, with hacpp
    the preset's; the unit depends on the model."""
    size: str | None = None
    """Target size of the encoded scene: 500kB, 1.2MB or 500000 bytes. Lambda starts at --lmbda and is adjusted after
    42 % of --iterations, or from the start if --init continues a finished scene."""
    iterations: int | None = None
    """Number of iterations; all phases are scaled in proportion. Default: 2400, or 720 if --init continues a scene
    (published schedules have 30000). --loss adds 30 % to a new training of the model causal; --model gaussians adds
    25 %, at most 2000."""
    voxel_size: float | None = None
    """Spacing of anchors in world units; 0 derives it from the points. Default: the preset's."""
    growth_interval: int | None = None
    """Iterations between changes of the set of anchors. Default: in proportion to --iterations, at least 50."""
    refine: int | None = None
    """Steps of refitting the context model at the end, which saves a few percent of the bytes with --model hacpp; 0 for
    none. Default: a quarter of the iterations, at most 600."""
    loss: tuple[str, ...] = ()
    """Loss models that the scene is trained for, as in `transmit` (bernoulli:0.2, gilbert:0.2,20), or first:SHARE, in
    which only the most important share of the anchors arrives. Of several, one is drawn for each iteration with loss.
    With --model gaussians, one loss model."""
    loss_share: float | None = None
    """Share of iterations with packet loss, default 0.5, counted from the first iteration that may lose packets. With
    the causal model, this is the first that --loss adds, or the first of all with --init of a finished scene; with a
    loss first:SHARE or the model hacpp, the first after the last anchors were added. Larger values reduce the effect of
    losses, and the quality without losses."""
    images: str | None = None
    """Name of the image folder, e.g. images_4. Default: images."""
    max_width: int = 1600
    """Maximum width of photos in pixels; wider ones are scaled down."""
    background: BackgroundOption = None
    """Background colour, RGB from 0 to 1, also behind transparent parts of photos. Default: that of the anchors of
    --init, otherwise black."""
    device: str = "auto"
    """Training device: auto, cpu or cuda (which renders with gsplat). auto selects cuda if it is usable."""
    init: Path | None = None
    """Scene file to train further on these photos; its anchors keep their positions and none are added. Or explicit
    Gaussians (PLY, .splat, ...): only their centres (with --model gaussians also their colours) are used, in place of
    the data's points."""
    seed: int = 0
    """Seed of all random choices."""
    resume: bool = False
    """Continue from the checkpoint next to the output, with the settings of the checkpoint. Give --images and
    --max-width as at the start: photos of another size are refused."""
    checkpoint_interval: int = 1000
    """Iterations between checkpoints."""
    preview: str | None = None
    """Picture to write after each test: the photo of the first test view next to its render."""
    serve: int | None = None
    """With --model gaussians: UDP port on which the scene is served while it is trained, 0 for a free one. `receive
    --follow` and `view` get its changes about once a second."""
    page: int | None = None
    """With --serve: TCP port of a web page that shows the scene, 0 for a free one. Streams are then sent over QUIC."""
    host: str = "127.0.0.1"
    """With --serve: address to listen on; 0.0.0.0 for all IPv4 addresses of this machine, :: for IPv6, too."""
    json: JsonFlag = False
    """Print one JSON object."""
