"""`splatwire import`: a model that other software trained becomes a file of ours, or a checked one."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from splatwire.cli._files import output_path
from splatwire.cli._output import JsonFlag, print_json, print_summary
from splatwire.errors import InvalidValueError


@dataclass(frozen=True)
class Import:
    """Import a model of other software: neural scenes as a scene file, explicit Gaussians as a standard PLY."""

    kind: tyro.conf.Positional[Literal["hacpp", "scaffold", "splats"]]
    """What it is: hacpp and scaffold are model folders of the official HAC++ and Scaffold-GS code and become a scene
    file; splats are explicit Gaussians (PLY, compressed PLY, SPZ, SOG, .splat, .ksplat, .glb), which are checked and
    written as a 3DGS PLY. Explicit Gaussians can be drawn (render), compared with (evaluate --reference) and started
    from (train --init)."""
    model_dir: tyro.conf.Positional[Path]
    """Its model folder, or the file."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Scene file or PLY to write."""
    appearance: int | None = None
    """Scaffold-GS with an appearance embedding: the number of the training camera whose colours are kept."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        if self.appearance is not None and self.kind != "scaffold":
            raise InvalidValueError("--appearance is for scaffold models")
        started = time.perf_counter()
        explicit = self.kind == "splats"
        with output_path(self.output, suffix=".ply" if explicit else "", json=self.json) as path:
            result = self._explicit(path) if explicit else self._neural(path)
            num_bytes = path.stat().st_size
        if self.json:
            seconds = time.perf_counter() - started
            print_json({"output": self.output, **result, "num_bytes": num_bytes, "seconds": seconds})
        else:
            count, what = (result.get(key) for key in ("num_anchors", "num_gaussians"))
            text = f"{count:,} anchors" if count is not None else f"{what:,} Gaussians"
            print_summary(f"{text}, {num_bytes:,} bytes -> {self.output}", self.output)

    def _neural(self, path: Path) -> dict[str, object]:
        from splatwire.importers.hacpp import import_hacpp
        from splatwire.importers.scaffold import import_scaffold
        from splatwire.model.scene_digest import scene_digest
        from splatwire.scene_io import save_scene

        if self.kind == "scaffold":
            scene = import_scaffold(self.model_dir, appearance=self.appearance)
        else:
            scene = import_hacpp(self.model_dir)
        save_scene(scene, path)
        return {"num_anchors": scene.anchors.num_anchors, "digest": scene_digest(scene.anchors)}

    def _explicit(self, path: Path) -> dict[str, object]:
        from splatwire.formats import read_content
        from splatwire.formats.ply import write_ply
        from splatwire.scene.metadata import metadata_to_json

        content = read_content(self.model_dir)
        splats, antialiased, origin = content.splats, content.antialiased, content.origin
        count = write_ply([splats], path, antialiased=antialiased, origin=origin, metadata=content.metadata)
        return {
            "num_gaussians": count, "degree": splats.degree, "antialiased": antialiased, "origin": list(origin),
            "metadata": metadata_to_json(content.metadata),
        }  # fmt: skip
