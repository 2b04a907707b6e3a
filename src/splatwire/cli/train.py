"""`splatwire train`: photos with poses become a scene file."""

import dataclasses
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from splatwire.cli._files import prepared_output
from splatwire.cli._output import JsonFlag, print_json, print_summary
from splatwire.cli._scenes import BackgroundOption, chosen_background
from splatwire.cli._training import check_same_recipe, parsed_size, told_size, watch
from splatwire.errors import BackendUnavailableError, InvalidValueError, UnknownNameError

if TYPE_CHECKING:
    from splatwire.data import Dataset
    from splatwire.train import QualityReport, TrainConfig, TrainResult
    from splatwire.train.state import TrainState

_DEVICES = ("auto", "cpu", "cuda")
_PLACES = {"cpu": "CPU", "cuda": "GPU"}
_PICTURES = (".png", ".jpg", ".jpeg", ".webp")
_PRESET_OF_LAYOUT = {"blender": "synthetic_nerf", "bungeenerf": "bungeenerf"}
CPU_ITERATIONS = 2400
"""Length of a run on a CPU unless the user says otherwise: minutes, not days."""
FINE_TUNING_ITERATIONS = 720
"""Length of a run that goes on with a finished scene."""


@dataclass(frozen=True)
class Train:
    """Train a scene from a folder of posed photos (COLMAP, BungeeNeRF, Blender or nerfstudio layout)."""

    data: tyro.conf.Positional[str]
    """Folder of the dataset."""
    output: Annotated[str, tyro.conf.arg(aliases=["-o"])]
    """Scene file to write; checkpoints go to the same name with .checkpoint added."""
    preset: str = "auto"
    """Recipe: mipnerf360, tanks_and_temples, deep_blending, bungeenerf or synthetic_nerf; auto chooses by the layout of
    the data."""
    model: str | None = None
    """What the scene will be coded with: causal (format 2) or hacpp (format 1: larger streams, and what the paper's
    interpolation and network were made for). causal if absent; a finished scene keeps its own."""
    lmbda: float | None = None
    """Weight of the rate (lambda): larger makes smaller scenes. The recipe's own if absent; its unit is the model's."""
    size: str | None = None
    """Bytes that the encoded scene is to have, as 500kB, 1.2MB or 500000: lambda is steered there in the second half of
    the run, from --lmbda on."""
    iterations: int | None = None
    """Length of the run; all phases keep their proportions. 2400 if absent, 720 with a scene to go on with (the
    published schedules have 30000). With --loss three tenths more follow."""
    voxel_size: float | None = None
    """Spacing of anchors in world units, 0 to derive it from the points. The recipe's own if absent."""
    growth_interval: int | None = None
    """Iterations between two changes of the anchors. In proportion to the length, and at least 50, if absent."""
    refine: int | None = None
    """Steps in which the context model is fitted again at the end, which saves some percent of the bytes; 0 for none.
    A quarter of the iterations, and at most 600, if absent."""
    loss: tuple[str, ...] = ()
    """Losses of packets that the scene is trained for, as transmit has them (bernoulli:0.2, gilbert:0.2,20), or
    first:SHARE, where nothing but the most important share of the anchors arrives. Of several, chance takes one each
    time."""
    loss_share: float | None = None
    """Share of the iterations for losses that lose packets; 0.5 where absent. The larger, the less a loss costs, and
    the more the complete picture."""
    images: str | None = None
    """Image folder instead of images (images_4, for example)."""
    max_width: int = 1600
    """Wider photos are reduced to this width."""
    background: BackgroundOption = None
    """RGB from 0 to 1 behind the scene and where photos are transparent; black where absent."""
    device: str = "auto"
    """auto, cpu or cuda (which draws with gsplat); auto is cuda where that works."""
    init: Path | None = None
    """A scene file goes on learning with these photos, its anchors where they are. Of explicit Gaussians (PLY, .splat,
    ...) the centres are the first anchors, instead of the data's points."""
    seed: int = 0
    """Seed of everything random."""
    resume: bool = False
    """Go on from the checkpoint beside the output; the recipe is that of the checkpoint."""
    checkpoint_interval: int = 1000
    """Iterations between checkpoints."""
    preview: str | None = None
    """Picture to write after each test: the first test view's photo and what the scene makes of it."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        device = self._check()
        import numpy as np
        from PIL import Image

        from splatwire.files.whole import written_whole
        from splatwire.scene_io import save_scene
        from splatwire.train import RunOptions, load_checkpoint, save_checkpoint, train_scene

        output = prepared_output(Path(self.output), suffix="")
        checkpoint = output.with_name(output.name + ".checkpoint")
        if self.resume:
            state, config = load_checkpoint(checkpoint)
            check_same_recipe(self._given(), self._config(), config)
            train, test = self._datasets(config)
        else:
            state, config, train, test = self._start(_PLACES[device])
            save_checkpoint(
                state, config, checkpoint
            )  # now, not in an hour, is when to learn that it cannot be written
        options = RunOptions(checkpoint, self.checkpoint_interval)

        def save_preview(report: "QualityReport") -> None:
            if self.preview:
                pixels = np.rint(np.clip(report.preview, 0, 1) * 255).astype(np.uint8)
                with written_whole(self.preview) as unfinished:
                    Image.fromarray(pixels).save(unfinished)

        with watch(save_preview) as listener:
            result = train_scene(train, test, config, state=state, options=options, listener=listener, device=device)
        if result.stopped:
            print(
                f"stopped after iteration {result.state.iteration:,} of {config.marks.iterations:,}; "
                "the same command with --resume goes on from there",
                file=sys.stderr,
            )
            raise KeyboardInterrupt
        save_scene(result.scene, output)
        self._report(result, config)

    def _start(self, place: str) -> "tuple[TrainState, TrainConfig, Dataset, Dataset | None]":
        """State and recipe before the first iteration, and the views."""
        from splatwire.scene_io import open_scene
        from splatwire.train.finetune import model_of
        from splatwire.train.initial import initial_state, points_of

        chosen = " (chosen by the data)" if self.preset == "auto" else ""
        start = None if self.init is None else open_scene(self.init)
        if start is not None and (model := model_of(start)) is not None:
            return self._going_on(start, model, f"{chosen}, on the {place}")
        config = self._config()
        train, test = self._datasets(config)
        more = f" and {config.marks.tuning:,} more for losses" if config.marks.tuning else ""
        told = f"recipe {config.preset}{chosen}, {config.marks.settled:,} iterations{more} on the {place}"
        print(told, file=sys.stderr)
        if start is not None:
            train = dataclasses.replace(train, points=points_of(start))
        if train.points is None or not train.points.num_points:
            print("the data has no points: the first anchors stand at random places", file=sys.stderr)
        return initial_state(train, config), config, train, test

    def _going_on(self, scene: Any, model: str, told: str) -> "tuple[TrainState, TrainConfig, Dataset, Dataset | None]":
        """The same for a finished scene."""
        from splatwire.train.finetune import fine_tuning, state_of_scene

        if self.voxel_size is not None or self.growth_interval is not None:
            raise InvalidValueError("anchors of a finished scene stay: no --voxel-size and no --growth-interval")
        if self.model not in (None, model):
            raise InvalidValueError(f"{self.init} is a scene of model {model}, which it keeps")
        iterations = FINE_TUNING_ITERATIONS if self.iterations is None else self.iterations
        config = fine_tuning(dataclasses.replace(self, iterations=iterations, model=model)._config(), scene)
        config = dataclasses.replace(config, background=chosen_background(self.background) or scene.background)
        train, test = self._datasets(config)
        print(f"{self.init} goes on for {iterations:,} iterations with recipe {config.preset}{told}", file=sys.stderr)
        return state_of_scene(scene, train, config), config, train, test

    def _check(self) -> str:
        if self.init is not None and self.resume:
            raise InvalidValueError("--init is for the start of a run: the checkpoint of --resume has its anchors")
        if self.output == "-":
            raise InvalidValueError("training writes a scene file and a checkpoint beside it: give -o a file")
        if self.preview is not None and prepared_output(Path(self.preview)).suffix.lower() not in _PICTURES:
            raise InvalidValueError(f"--preview must end in {', '.join(_PICTURES)}, not {self.preview}")
        if self.loss_share is not None and not self.loss:
            raise InvalidValueError("--loss-share says how often --loss loses packets, which is not given")
        if self.checkpoint_interval < 1:
            raise InvalidValueError(f"--checkpoint-interval must be 1 or more, not {self.checkpoint_interval}")
        return check_device(self.device)

    def _given(self) -> list[str]:
        """Options that are not as they are where nobody gives them."""
        fields = [field for field in dataclasses.fields(self) if field.default is not dataclasses.MISSING]
        return [field.name.replace("_", "-") for field in fields if getattr(self, field.name) != field.default]

    def _config(self) -> "TrainConfig":
        from splatwire.data import dataset_layout
        from splatwire.scene.background import BLACK
        from splatwire.train import create_config
        from splatwire.train.config import LossTraining
        from splatwire.train.presets import DEFAULT_MODEL

        preset = self.preset
        if preset == "auto":
            preset = _PRESET_OF_LAYOUT.get(dataset_layout(Path(self.data)) or "", "mipnerf360")
        return create_config(
            preset,
            model=self.model or DEFAULT_MODEL,
            lmbda=self.lmbda,
            size=0 if self.size is None else parsed_size(self.size),
            iterations=CPU_ITERATIONS if self.iterations is None else self.iterations,
            voxel_size=self.voxel_size,
            growth_interval=self.growth_interval,
            refine_steps=self.refine,
            losses=self.loss,
            loss_share=LossTraining.share if self.loss_share is None else self.loss_share,
            background=chosen_background(self.background) or BLACK,
            seed=self.seed,
        )

    def _datasets(self, config: "TrainConfig") -> "tuple[Dataset, Dataset | None]":
        from splatwire.data import open_dataset
        from splatwire.errors import DatasetError
        from splatwire.scene.origin import NO_ORIGIN

        def opened(split: str) -> "Dataset":
            found = open_dataset(
                Path(self.data),
                split=split,
                images=self.images,
                max_width=self.max_width,
                test_views=config.test_views,
                background=config.background,
            )
            return replace(found, cameras=found.cameras.relative_to(NO_ORIGIN))  # anchors have no origin

        train = opened("train")
        try:
            return train, opened("test")
        except DatasetError as error:
            print(f"no test views: {error}", file=sys.stderr)
            return train, None

    def _report(self, result: "TrainResult", config: "TrainConfig") -> None:
        test, scene, size = result.test, result.scene, told_size(result.scene, config.weights.size)
        if self.json:
            print_json(
                {
                    "output": self.output,
                    "iterations": result.state.iteration,
                    "num_anchors": scene.anchors.num_anchors,
                    "num_gaussians": int(scene.anchors.mask.sum()),
                    "test_psnr": test.psnr if test else None,
                    "test_ssim": test.ssim if test else None,
                    **({"stream_bytes": size} if size else {}),
                    "seconds": result.seconds,
                    "recipe": dataclasses.asdict(config),
                }
            )
            return
        quality = f", test PSNR {test.psnr:.2f} dB, SSIM {test.ssim:.4f}" if test else ""
        quality += f", {size:,} bytes as a stream" if size else ""
        print_summary(f"{scene.anchors.num_anchors:,} anchors{quality}, {result.seconds:,.0f} s -> {self.output}")


def check_device(name: str) -> str:
    """Checks that a run can have the device that it asks for, and returns its name, `cpu` or `cuda`.

    `auto` is the GPU where torch finds one and gsplat draws on it; if only gsplat is missing, that is said.

    Raises:
        UnknownNameError: There is no such device.
        BackendUnavailableError: It is a GPU. The message names what is missing, first of all on this machine.
    """
    if name not in _DEVICES:
        raise UnknownNameError("device", name, _DEVICES)
    if name == "cpu":
        return "cpu"
    import torch

    if name == "auto" and not torch.cuda.is_available():
        return "cpu"
    try:
        _check_gpu()
    except BackendUnavailableError as error:
        if name == "cuda":
            raise
        print(f"training on the CPU: {error}", file=sys.stderr)
        return "cpu"
    return "cuda"


def _check_gpu() -> None:
    import importlib.util

    import torch

    instead = "train on the CPU with --device cpu"
    if not torch.cuda.is_available():
        raise BackendUnavailableError("cuda", f"torch finds no CUDA device; install its CUDA build, or {instead}")
    if importlib.util.find_spec("gsplat") is None:
        raise BackendUnavailableError("cuda", f"gsplat is missing; pip install 'splatwire[gpu]', or {instead}")
    from splatwire.render.gsplat_backend import check_gsplat

    print("trying gsplat, which compiles its kernels when it is new", file=sys.stderr)
    check_gsplat()
