"""`splatwire evaluate`: a stream or scene is scored."""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatwire.cli._evaluate_options import EvaluateOptions
from splatwire.cli._files import check_folder, check_inputs, input_path, is_stream
from splatwire.cli._output import print_json, progress_bars
from splatwire.cli._scenes import chosen_background
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from splatwire.evaluate.study import Row, SceneEntry, Study
    from splatwire.packets import SceneStream


@dataclass(frozen=True)
class Evaluate(EvaluateOptions):
    """Score a stream or scene: lose packets, conceal, draw the test views and compare."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.packets import read_stream

        self._check()
        with input_path(self.source) as path:
            if self.path is not None:
                self._evaluate_path(read_stream(path)[0])
            elif is_stream(path) and (stream := read_stream(path)[0]).manifest.schema.timed:
                self._evaluate_clip(stream)
            else:
                self._evaluate_scene(path)

    def _evaluate_path(self, stream: "SceneStream") -> None:
        from splatwire.cli._path_evaluation import evaluate_path, print_path_facts

        with progress_bars() as show:
            content = evaluate_path(self, stream, show)
        self._tell(content, lambda: print_path_facts(content, Path(self.source).name))

    def _evaluate_clip(self, stream: "SceneStream") -> None:
        from splatwire.cli._clip_evaluation import check_clip_options, evaluate_clip, print_clip_rows

        check_clip_options(self)
        with progress_bars() as show:
            content = evaluate_clip(self, stream, show)
        self._tell(content, lambda: print_clip_rows(content, Path(self.source).name))

    def _tell(self, content: "Mapping[str, Any]", show: "Callable[[], None]") -> None:
        """Prints what was found, and where the report is."""
        if self.json:
            print_json(content)
            return
        show()
        if content["report"] is not None:
            print(f"report: {content['report']}")

    def _evaluate_scene(self, path: Path) -> None:
        from splatwire.evaluate.study import (
            InProcess,
            MemoryStore,
            plain_content,
            run_loss_curve,
            run_study,
            write_report,
        )

        self._check_scene_options()
        with progress_bars() as show, tempfile.TemporaryDirectory(prefix="splatwire-") as folder:
            store = MemoryStore(Path(folder))
            result = run_study(self.study(path), store, InProcess(progress=show), show)
            content = plain_content(result)
            report = None
            if self.output is not None:
                curve = run_loss_curve(result, store, InProcess(progress=show), show)
                report = write_report(result, store, self.output, content, curve=curve)
        from splatwire.cli._table import print_rows

        content["report"] = None if report is None else str(report)
        title, note = result.study.title, result.lpips_note
        self._tell(content, lambda: print_rows(content["rows"], title, lpips_note=note))

    def _check(self) -> None:
        """Tells what is wrong with the options before any work.

        Raises:
            InvalidValueError: If options are missing, or mean nothing here.
            UnknownNameError: If there is no such concealer or renderer.
        """
        from splatwire.cli._clips import check_concealer
        from splatwire.cli._path_evaluation import check_path_options
        from splatwire.render import create_renderer

        if self.source.endswith(".toml"):
            raise InvalidValueError(
                f"{self.source} is a protocol, which `splatwire study {self.source} -o FOLDER` runs"
            )
        check_inputs(self.data, self.reference, self.cameras, self.path)
        check_path_options(self)
        if self.output is not None:
            check_folder(self.output)
        if self.loss is None:
            for name in ("seeds", "contiguous"):
                if getattr(self, name):
                    raise InvalidValueError(f"--{name} needs --loss: without it nothing is sent")
        for concealer in self.conceal:
            check_concealer(concealer)
        create_renderer(self.renderer)

    def _check_scene_options(self) -> None:
        from splatwire.conceal import create_concealer

        if self.reference is None and (self.data is None or self.cameras is not None):
            raise InvalidValueError("give --data FOLDER, or --reference SCENE (with --cameras FILE or --data FOLDER)")
        if self.cameras is not None and self.data is not None:
            raise InvalidValueError("give either --cameras FILE or --data FOLDER")
        for concealer in self.conceal:
            create_concealer(concealer)

    def study(self, path: Path) -> "Study":
        """What is compared.

        Args:
            path: The stream or scene file.
        """
        from splatwire.evaluate.study import Loss, SceneEntry, Study

        background, kind = chosen_background(self.background), "stream" if is_stream(path) else "scene"
        name = Path(self.source).name
        entry = SceneEntry(
            name=Path(self.source).stem if self.source != "-" else "standard input",
            source=path,
            kind=kind,
            photos=self.data,
            cameras=self.cameras,
            reference=self.reference,
            background=background,
        )
        rows = self._rows(entry)
        lossy = [row.key for row in rows if not row.lossless and row.label != "contiguous drop"]
        return Study(
            name=entry.name,
            title=f"{name} {'as it is' if self.loss is None else 'under ' + self.loss}",
            scenes=(entry,),
            rows=rows,
            losses=(Loss(self.loss or "none"),),
            seeds=self.seeds or (0,),
            baseline=lossy[0] if lossy else None,
            views=self.views,
            lpips_views=self.lpips_views,
            renderer=self.renderer,
        )

    def _rows(self, entry: "SceneEntry") -> "tuple[Row, ...]":
        from splatwire.codec import schema_named, schema_of
        from splatwire.conceal import concealer_names
        from splatwire.evaluate.study import Row, concealment_rows
        from splatwire.model import Partial
        from splatwire.model.appearance import scene_of
        from splatwire.packets import packetization_named, read_stream
        from splatwire.packets.sections import sections_of
        from splatwire.scene_io import read_scene_file

        if entry.kind == "stream":
            stream = read_stream(entry.source)[0].still(entry.source)
            manifest, packed = stream.manifest, stream.manifest.packetization
            sections, codec = sections_of(stream), manifest.codec
            complete = len(stream.packets) == manifest.num_packets
        else:
            found = read_scene_file(entry.source)
            loaded, complete = found.loaded, found.num_lost == 0
            if self.loss is None and scene_of(loaded) is loaded:
                name = "no loss" if complete else "as it is"
                return (Row(name, name, None, lossless=complete),)
            scene = scene_of(loaded)
            codec = schema_of(scene).name
            packed = packetization_named(None, codec, int(scene.drawable.sum()))
            sections = dict(loaded.sections) if isinstance(loaded, Partial) else {}
        names = self.conceal or concealer_names(sections, schema_named(codec).offers)
        if self.loss is None:
            return concealment_rows(() if complete else names, complete=complete)
        contiguous = replace(packed, grouping="contiguous") if self.contiguous else None
        return concealment_rows(
            names, None if entry.kind == "stream" else packed, complete=complete, contiguous=contiguous
        )
