"""Options of `splatwire convert`."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from splatwire.cli._options import JsonFlag


@dataclass(frozen=True)
class Convert:
    """Convert files of scenes and clips to another format, one or many: streams, explicit Gaussians, frames.

    `convert IN OUT` writes one output; `convert IN... --to FORMAT -o FOLDER` writes one output per input. Runs without
    a GPU. The results are those of `encode`, `export` and `decode` with their defaults; these verbs have more options.
    """

    sources: tyro.conf.Positional[tuple[str, ...]]
    """Inputs in any readable format, clips included: a folder with one file per frame, a .splatv file or a stream.
    Without -o the last one is the output."""
    output: Annotated[str | None, tyro.conf.arg(aliases=["-o"])] = None
    """Output file of one input; with --to, a folder with one output per input, which is created if it is missing."""
    to: str | None = None
    """Format of the outputs: swz, ply, compressed-ply, spz, sog, splat, glb, usdc, 3dtiles or streamed-sog (a folder
    with levels of detail), or a format of an installed package. A clip is converted to swz, usdc, 4dgs or splat4d, or
    to a folder with one file of another format per frame. Default: the suffix of the output."""
    jobs: int = 1
    """Number of inputs that are converted at the same time, each in a separate process."""
    accept_damage: bool = False
    """Exit with status 0 even if bytes of a stream are damaged. Missing packets do not need this option."""
    json: JsonFlag = False
    """Print one JSON object."""
