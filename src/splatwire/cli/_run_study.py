"""Implementation of `splatwire study`: runs the evaluation defined by a protocol file."""

import dataclasses
import importlib.util
from pathlib import Path

from splatwire.bitstream import is_stream
from splatwire.cli._bundled import ASSETS, CAMERAS, SCENE
from splatwire.cli._files import check_folder
from splatwire.cli._output import print_json, progress_bars
from splatwire.cli.study import StudyCommand
from splatwire.errors import BackendUnavailableError, InvalidValueError, how_to_install
from splatwire.evaluation.study import (
    SceneEntry,
    Store,
    Study,
    StudyResult,
    create_engine,
    load_study,
    measure_study_sizes,
    run_study,
    summarize,
    write_outputs,
    write_size_outputs,
)
from splatwire.evaluation.study.slurm_options import SlurmOptions
from splatwire.files.kinds import HACPP, WITHOUT_GAUSSIANS, file_kind, format_error, last_iteration
from splatwire.files.names import real_path

BUNDLED = "bundled"
_REPORT = ("jinja2", "matplotlib")
_RECORDS = ("pyarrow",)
"""Modules needed only for writing results; their absence is reported before the work."""


def run(command: StudyCommand) -> None:
    """Runs `splatwire study`: performs an evaluation that is defined by a protocol file."""
    study = study_of(command)
    check_folder(command.output)
    engine = create_engine(command.engine, command.workers, _slurm(command))
    store = Store(real_path(command.output / "store"))
    _check_modules(_REPORT if study.kind == "sizes" else (*_REPORT, *_RECORDS))
    if study.kind == "sizes":
        _run_sizes(command, study, store)
        return
    with progress_bars() as show:
        result = run_study(study, store, engine, show)
        files = write_outputs(result, store, command.output)
    _print_result(command, result, files)


def _slurm(command: StudyCommand) -> SlurmOptions | None:
    values = {name: getattr(command, name) for name in ("partition", "account", "minutes", "memory_gb")}
    chosen = {name: value for name, value in values.items() if value is not None}
    return SlurmOptions(**chosen) if chosen else None


def _run_sizes(command: StudyCommand, study: Study, store: Store) -> None:
    with progress_bars() as show:
        files = write_size_outputs(study, measure_study_sizes(study, store, show), command.output)
    if command.json:
        print_json({"protocol": study.name, "files": {name: str(path) for name, path in files.items()}})
        return
    print(files["markdown"].read_text(encoding="utf-8"))
    print(f"report: {files['report']}")


def study_of(command: StudyCommand) -> Study:
    """Reads the definition of an evaluation from its protocol file. Command-line options override its values."""
    study = load_study(command.protocol, replaced=_replaced_scene(command))
    return dataclasses.replace(
        study,
        seeds=command.seeds or study.seeds,
        views=study.views if command.views is None else command.views,
        lpips_views=study.lpips_views if command.lpips_views is None else command.lpips_views,
        renderer=study.renderer if command.renderer is None else command.renderer,
    )


def _replaced_scene(command: StudyCommand) -> SceneEntry | None:
    if command.scene is None:
        if command.photos or command.cameras or command.weights:
            raise InvalidValueError("--photos, --cameras and --weights describe the scene of --scene: give that, too")
        return None
    if command.photos is not None and command.cameras is not None:
        raise InvalidValueError("give --photos or --cameras, not both: photos have their own cameras")
    source, cameras = Path(command.scene), command.cameras
    if command.scene == BUNDLED:
        source, cameras = ASSETS / SCENE, None if command.photos else command.cameras or ASSETS / CAMERAS
    for path in (source, command.photos, cameras, command.weights):
        if path is not None and not path.exists():
            raise InvalidValueError(f"{path} does not exist")
    return SceneEntry(
        name=source.name if source.is_dir() else source.stem,
        source=real_path(source),
        kind=_kind_of(source),
        photos=command.photos,
        cameras=cameras,
        weights=real_path(command.weights) if command.weights else None,
    )


def _kind_of(source: Path) -> str:
    """Returns the kind of a scene for `SceneEntry.kind`.

    Raises:
        InvalidValueError: If the scene is a model folder without Gaussians, or one of Scaffold-GS.
    """
    if (kind := file_kind(source)) is WITHOUT_GAUSSIANS:
        raise InvalidValueError(format_error(source, "a stream, scene file or model folder with a scene"))
    if kind is not HACPP:
        return "stream" if is_stream(source) else "scene"
    # Folders of HAC++ and Scaffold-GS are told apart by this file: Scaffold-GS writes its networks as `*_mlp.pt`.
    iteration = last_iteration(source) or source
    if not (iteration / "checkpoint.pth").is_file():
        raise InvalidValueError(
            f"{iteration}: has no checkpoint.pth, in which HAC++ writes its networks; a model of Scaffold-GS becomes a "
            "scene file with `splatwire import scaffold`"
        )
    return "model"


def _print_result(command: StudyCommand, result: StudyResult, files: dict[str, Path]) -> None:
    counts = {
        "num_computed": result.num_computed,
        "num_reused": result.num_reused,
        "num_lost_workers": result.num_lost_workers,
    }
    if command.json:
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
    """Checks, before the evaluation starts, that Python modules are installed.

    Args:
        names: Names of the modules.

    Raises:
        BackendUnavailableError: If a module is missing; the message explains how to install it.
    """
    for name in names:
        if importlib.util.find_spec(name) is None:
            raise BackendUnavailableError(name, how_to_install(name) or "it is not installed")
