"""`splatwire render`: a scene becomes pictures."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._files import check_folder, input_path, is_stream, prepared_output
from splatwire.cli._output import JsonFlag, print_json, print_summary, progress_bars
from splatwire.cli._scenes import BackgroundOption, chosen_background
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.packets import SceneStream
    from splatwire.scene import Cameras
    from splatwire.scene.background import Background


@dataclass(frozen=True)
class Render:
    """Draw a scene from every camera and save the pictures as PNG files; of a clip a moving picture."""

    scene: tyro.conf.Positional[str]
    """Scene file, decoded scene with gaps, stream, or explicit Gaussians (PLY, SPZ, SOG, ...); - for standard input."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the pictures and a cameras.json; for a clip a .webp file."""
    cameras: Path | None = None
    """Cameras file; without it and --data, views from around the scene that frame it. A clip is drawn from one after
    another."""
    data: Annotated[Path | None, tyro.conf.arg(aliases=["-s"])] = None
    """Dataset folder whose test views are drawn, instead of a cameras file."""
    scale: float = 1.0
    """Factor on the size of the pictures."""
    conceal: str | None = None
    """Concealer for a scene with gaps; drop where absent, of a clip motion."""
    renderer: str = "cpu"
    """Renderer: cpu, reference or gsplat."""
    background: BackgroundOption = None
    """RGB from 0 to 1 behind everything; what the scene was trained in front of where absent."""
    accept_damage: bool = False
    """Exit with status 0 although bytes of the stream are damaged; packets that are only missing need no option."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        cameras = find_cameras(self.cameras, self.data)
        if not 0 < self.scale <= 16:
            raise InvalidValueError(f"--scale must be above 0 and at most 16, not {self.scale:g}")
        from splatwire.packets import read_stream

        background = chosen_background(self.background)
        if is_stream(Path(self.scene)) and (stream := read_stream(self.scene)[0]).manifest.schema.timed:
            self._draw_clip(stream, cameras)
            return
        self._draw_scene(cameras, background)

    def _draw_clip(self, stream: "SceneStream", cameras: "Cameras | None") -> None:
        from splatwire.cli._clips import draw_clip

        if self.output.suffix.lower() != ".webp":
            raise InvalidValueError(
                f"a clip becomes a moving picture: give a name such as name.webp, not {self.output}"
            )
        prepared_output(self.output, suffix=".webp")
        if self.background is not None:
            raise InvalidValueError("--background is for a still scene; a clip has its own from `encode`")
        started = time.perf_counter()
        with progress_bars() as show:
            facts = draw_clip(stream, self.output, cameras, self.scale, self.conceal, self.renderer, show)
        seconds = time.perf_counter() - started
        if self.json:
            print_json({"output": str(self.output), **facts, "seconds": seconds})
        else:
            print_summary(f"{facts['num_frames']} frames in {seconds:.1f} s -> {self.output}")

    def _draw_scene(self, cameras: "Cameras | None", background: "Background | None") -> None:
        from splatwire.conceal import create_concealer
        from splatwire.data import save_cameras
        from splatwire.evaluate.pixels import png_bytes, to_pixels
        from splatwire.evaluate.views import views_of
        from splatwire.files.names import distinct_names
        from splatwire.files.whole import write_whole
        from splatwire.render.framing import framing_cameras
        from splatwire.scene_io import drawable_scene

        concealer = create_concealer(self.conceal or "drop")
        check_folder(self.output)
        with input_path(self.scene) as source:
            scene, num_lost = drawable_scene(source, concealer)
        cameras = framing_cameras(scene, _AROUND, _AROUND_SIZE) if cameras is None else cameras
        cameras = cameras if self.scale == 1 else cameras.scaled(self.scale)
        started, files = time.perf_counter(), [f"{name}.png" for name in distinct_names(cameras.names, "view")]
        with progress_bars() as show:
            for view, image in enumerate(views_of(scene, cameras, self.renderer, background)):
                write_whole(self.output / files[view], png_bytes(to_pixels(image)))
                show("drawing", (view + 1) / cameras.num_views)
        seconds = time.perf_counter() - started
        save_cameras(cameras, self.output / "cameras.json")
        if self.json:
            print_json(
                {
                    "output": str(self.output),
                    "pictures": files,
                    "num_views": cameras.num_views,
                    "width": cameras.width,
                    "height": cameras.height,
                    f"num_{scene.ELEMENTS.lower()}": scene.num_elements,
                    "num_lost": num_lost,
                    "seconds": seconds,
                }
            )
        else:
            size = f"{cameras.width} x {cameras.height}"
            print_summary(f"{cameras.num_views} pictures of {size} in {seconds:.1f} s -> {self.output}")


_AROUND, _AROUND_SIZE = 12, 512
"""Views around a scene, and their width and height in pixels."""


def find_cameras(cameras: Path | None, data: Path | None) -> "Cameras | None":
    """Reads a cameras file, or the test cameras of a dataset; None if there is neither.

    Raises:
        InvalidValueError: If both are given.
        DatasetError: If it cannot be read.
    """
    if cameras is not None and data is not None:
        raise InvalidValueError("give either --cameras FILE or --data FOLDER")
    from splatwire.data import load_cameras, open_dataset

    if cameras is not None:
        return load_cameras(cameras)
    return None if data is None else open_dataset(data, split="test").cameras
