"""`splatwire study`: a protocol file runs."""

import dataclasses
import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatwire.cli._bundled import ASSETS, CAMERAS, SCENE
from splatwire.cli._files import check_folder
from splatwire.cli._output import JsonFlag, print_json, progress_bars
from splatwire.errors import BackendUnavailableError, InvalidValueError, how_to_install

if TYPE_CHECKING:
    from splatwire.evaluate.study import SceneEntry, Store, Study, StudyResult
    from splatwire.evaluate.study.slurm_options import SlurmOptions

BUNDLED = "bundled"
_REPORT = ("jinja2", "matplotlib")
_RECORDS = ("pyarrow",)
"""Modules that only write what was found; their absence is reported before the work."""


@dataclass(frozen=True)
class StudyCommand:
    """Run a protocol file: scenes, rows, losses and seeds; what is finished is not computed again."""

    protocol: tyro.conf.Positional[Path]
    """Protocol file (.toml), as in benchmarks/paper."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for records, tables, the report, and finished work (its folder store)."""
    scene: str | None = None
    """A stream, scene file, HAC++ folder, or the word bundled, instead of the protocol's scenes."""
    photos: Path | None = None
    """Dataset folder of --scene; without it --cameras, and the scene's own renders as references."""
    cameras: Path | None = None
    """Cameras file of --scene."""
    weights: Path | None = None
    """Calibrated GNN weights of --scene."""
    seeds: tuple[int, ...] = ()
    """One transmission per seed, instead of the protocol's."""
    views: int | None = None
    """Most views, spread evenly, instead of the protocol's."""
    lpips_views: int | None = None
    """Most views that LPIPS is computed on (slow on a CPU), instead of the protocol's."""
    renderer: str | None = None
    """cpu, reference or gsplat, instead of the protocol's."""
    engine: str = "local"
    """local (processes), ray (RAY_ADDRESS or a local cluster) or slurm."""
    workers: int | None = None
    """Workers at a time; one per processor where absent."""
    partition: str | None = None
    """Partition of --engine slurm."""
    account: str | None = None
    """Account of --engine slurm."""
    minutes: int | None = None
    """Time limit of a job of --engine slurm; 240 where absent."""
    memory_gb: int | None = None
    """Memory of a job of --engine slurm; 8 where absent."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.evaluate.study import Store, create_engine, run_study, write_outputs

        study = self.study()
        check_folder(self.output)
        engine = create_engine(self.engine, self.workers, self._slurm())
        store = Store((self.output / "store").resolve())
        _check_modules(_REPORT if study.kind == "sizes" else (*_REPORT, *_RECORDS))
        if study.kind == "sizes":
            self._run_sizes(study, store)
            return
        with progress_bars() as show:
            result = run_study(study, store, engine, show)
            files = write_outputs(result, store, self.output)
        self._tell(result, files)

    def _slurm(self) -> "SlurmOptions | None":
        from splatwire.evaluate.study.slurm_options import SlurmOptions

        values = {name: getattr(self, name) for name in ("partition", "account", "minutes", "memory_gb")}
        given = {name: value for name, value in values.items() if value is not None}
        return SlurmOptions(**given) if given else None

    def _run_sizes(self, study: "Study", store: "Store") -> None:
        from splatwire.evaluate.study import measure_study_sizes, write_size_outputs

        with progress_bars() as show:
            files = write_size_outputs(study, measure_study_sizes(study, store, show), self.output)
        if self.json:
            print_json({"protocol": study.name, "files": {name: str(path) for name, path in files.items()}})
            return
        print(files["markdown"].read_text(encoding="utf-8"))
        print(f"report: {files['report']}")

    def study(self) -> "Study":
        """The protocol, with what the options change."""
        from splatwire.evaluate.study import load_study

        study = load_study(self.protocol, replaced=self._replaced_scene())
        return dataclasses.replace(
            study,
            seeds=self.seeds or study.seeds,
            views=study.views if self.views is None else self.views,
            lpips_views=study.lpips_views if self.lpips_views is None else self.lpips_views,
            renderer=study.renderer if self.renderer is None else self.renderer,
        )

    def _replaced_scene(self) -> "SceneEntry | None":
        from splatwire.cli._files import is_stream
        from splatwire.evaluate.study import SceneEntry

        if self.scene is None:
            if self.photos or self.cameras or self.weights:
                raise InvalidValueError(
                    "--photos, --cameras and --weights describe the scene of --scene: give that, too"
                )
            return None
        if self.photos is not None and self.cameras is not None:
            raise InvalidValueError("give --photos or --cameras, not both: photos have their own cameras")
        source, cameras = Path(self.scene), self.cameras
        if self.scene == BUNDLED:
            source, cameras = ASSETS / SCENE, None if self.photos else self.cameras or ASSETS / CAMERAS
        for path in (source, self.photos, cameras, self.weights):
            if path is not None and not path.exists():
                raise InvalidValueError(f"{path} does not exist")
        kind = "model" if (source / "point_cloud").is_dir() else "stream" if is_stream(source) else "scene"
        return SceneEntry(
            name=source.name if kind == "model" else source.stem,
            source=source.resolve(),
            kind=kind,
            photos=self.photos,
            cameras=cameras,
            weights=self.weights.resolve() if self.weights else None,
        )

    def _tell(self, result: "StudyResult", files: dict[str, Path]) -> None:
        counts = {
            "num_computed": result.num_computed,
            "num_reused": result.num_reused,
            "num_lost_workers": result.num_lost_workers,
        }
        if self.json:
            from splatwire.evaluate.study import summarize

            rows = [summary.to_json() for summary in summarize(result)]
            paths = {name: str(path) for name, path in files.items()}
            print_json(
                {"protocol": result.study.name, **counts, "skipped": list(result.skipped), "rows": rows, "files": paths}
            )
            return
        for note in result.skipped:
            print(f"note: {note}")
        print(files["markdown"].read_text(encoding="utf-8"))
        lost = f", {result.num_lost_workers} workers were lost" if result.num_lost_workers else ""
        print(f"{result.num_computed} units computed, {result.num_reused} were there{lost}")
        print(f"report: {files['report']}")


def _check_modules(names: tuple[str, ...]) -> None:
    """Checks before the work that modules are installed.

    Raises:
        BackendUnavailableError: If one is not; the message says how to install it.
    """
    for name in names:
        if importlib.util.find_spec(name) is None:
            raise BackendUnavailableError(name, how_to_install(name) or "it is not installed")
