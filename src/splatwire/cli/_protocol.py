"""The part of `splatwire evaluate` that runs protocol files."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from splatwire.cli._bundled import ASSETS, CAMERAS, SCENE
from splatwire.cli._output import print_json, progress_bars
from splatwire.cli._scenes import chosen_background
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.cli.evaluate import Evaluate
    from splatwire.evaluate.study import SceneEntry, Store, Study, StudyResult

BUNDLED = "bundled"
_NOT_WITH_PROTOCOLS = ("data", "reference", "loss", "conceal", "contiguous", "send_order")


def run_protocol(settings: "Evaluate") -> None:
    """Runs a protocol file and writes its outputs.

    Raises:
        InvalidValueError: If options contradict each other.
        SplatwireError: If the protocol is wrong or a unit of work fails.
    """
    from splatwire.evaluate.study import Store, create_engine, run_study, write_outputs

    if settings.output is None:
        raise InvalidValueError("a protocol needs -o FOLDER: its records, tables and report go there")
    for name in _NOT_WITH_PROTOCOLS:
        if getattr(settings, name):
            raise InvalidValueError(f"--{name.replace('_', '-')} is not for protocol files: edit the protocol")
    study = study_of(settings)
    engine = create_engine(settings.engine or "local", settings.workers)
    store = Store((settings.store or settings.output / "store").resolve())
    if study.kind == "sizes":
        _run_sizes(settings, study, store)
        return
    with progress_bars() as show:
        result = run_study(study, store, engine, show)
        files = write_outputs(result, store, settings.output)
    _tell(settings, result, files)


def _run_sizes(settings: "Evaluate", study: "Study", store: "Store") -> None:
    from splatwire.evaluate.study import measure_study_sizes, write_size_outputs

    assert settings.output is not None
    with progress_bars() as show:
        files = write_size_outputs(study, measure_study_sizes(study, store, show), settings.output)
    if settings.json:
        print_json({"protocol": study.name, "files": {name: str(path) for name, path in files.items()}})
        return
    print(files["markdown"].read_text(encoding="utf-8"))
    print(f"report: {files['report']}")


def study_of(settings: "Evaluate") -> "Study":
    """The protocol of the command line, with what its options change."""
    from splatwire.evaluate.study import load_study

    replaced = _replaced_scene(settings)
    study = load_study(Path(settings.source), data_root=settings.data_root, replaced=replaced)
    background, scenes = chosen_background(settings.background), study.scenes
    if background is not None:
        scenes = tuple(dataclasses.replace(entry, background=background) for entry in scenes)
    return dataclasses.replace(
        study,
        scenes=scenes,
        seeds=settings.seeds or study.seeds,
        views=settings.views or study.views,
        lpips_views=settings.lpips_views or study.lpips_views,
        renderer=settings.renderer or study.renderer,
    )


def _replaced_scene(settings: "Evaluate") -> "SceneEntry | None":
    from splatwire.cli._files import is_stream
    from splatwire.evaluate.study import SceneEntry

    if settings.scene is None:
        if settings.photos or settings.cameras or settings.weights or settings.scene_name:
            raise InvalidValueError(
                "--photos, --cameras, --weights and --scene-name describe the scene of --scene: give that, too"
            )
        return None
    cameras: Path | None
    if settings.scene == BUNDLED:
        source, cameras = ASSETS / SCENE, settings.cameras or ASSETS / CAMERAS
    else:
        source = Path(settings.scene)
        cameras = settings.cameras
    for path in (source, settings.photos, cameras, settings.weights):
        if path is not None and not path.exists():
            raise InvalidValueError(f"{path} does not exist")
    kind = "model" if (source / "point_cloud").is_dir() else "stream" if is_stream(source) else "scene"
    name = settings.scene_name or (source.name if kind == "model" else source.stem)
    return SceneEntry(
        name=name,
        source=source.resolve(),
        kind=kind,
        photos=settings.photos,
        cameras=None if settings.photos else cameras,
        weights=settings.weights.resolve() if settings.weights else None,
    )


def _tell(settings: "Evaluate", result: "StudyResult", files: dict[str, Path]) -> None:
    counts = {
        "num_computed": result.num_computed,
        "num_reused": result.num_reused,
        "num_lost_workers": result.num_lost_workers,
    }
    if settings.json:
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
