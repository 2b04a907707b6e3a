"""`splatwire import`: a model that other software trained becomes a scene file."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from splatwire.cli._files import output_path
from splatwire.cli._output import JsonFlag, print_json, print_summary


@dataclass(frozen=True)
class Import:
    """Import a model of other software as a scene file."""

    kind: tyro.conf.Positional[Literal["hacpp"]]
    """What wrote it: hacpp is the official HAC++ code."""
    model_dir: tyro.conf.Positional[Path]
    """Its model folder."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Scene file to write."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.importers.hacpp import import_hacpp
        from splatwire.model.scene_digest import scene_digest
        from splatwire.model.scene_file import save_scene

        started = time.perf_counter()
        with output_path(self.output, json=self.json) as path:
            scene = import_hacpp(self.model_dir)
            save_scene(scene, path)
            num_bytes = path.stat().st_size
        if self.json:
            print_json(
                {
                    "output": self.output,
                    "num_anchors": scene.anchors.num_anchors,
                    "num_bytes": num_bytes,
                    "digest": scene_digest(scene.anchors),
                    "seconds": time.perf_counter() - started,
                }
            )
        else:
            print_summary(f"{scene.anchors.num_anchors:,} anchors, {num_bytes:,} bytes -> {self.output}", self.output)
