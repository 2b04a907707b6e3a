"""`splatwire demo`: the whole journey on the scene that comes with the package."""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from splatwire.cli._bundled import ASSETS, CAMERAS, SCENE, SPLATS
from splatwire.cli._files import check_folder
from splatwire.cli._output import JsonFlag, print_json, progress_bars

if TYPE_CHECKING:
    from splatwire.evaluate.study import Study
    from splatwire.model.appearance import Partial
    from splatwire.packets import SceneStream

_LPIPS_VIEWS = 2
"""LPIPS takes seconds per picture on a CPU; on two views the demo still fits in two minutes."""
_NOTES = (
    "A compressed scene was split into independently decodable packets, some of them were lost, a fresh process "
    "decoded what had arrived, each concealer dealt with the gaps, and the CPU renderer drew the test views.",
    "The reference pictures are the lossless scene's own renders, not photos: the numbers say what the losses cost. "
    "The row contiguous drop is the same scene with packets of neighbouring anchors; all others use stratified lanes.",
    "The paper's network has no row: on this scene it learns nothing beyond kriging (docs/cari-findings.md).",
)


@dataclass(frozen=True)
class Demo:
    """Lose 20 % of a real scene's packets, conceal, draw, score, and write a report."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("splatwire-demo")
    """Folder for the report."""
    loss: str = "bernoulli:0.2"
    """What is lost: none, bernoulli:RATE, gilbert:RATE,BURST, gilbert:PRESET or trace:FILE; the unit is a .pak."""
    seed: int = 0
    """Seed of the losses."""
    views: int | None = None
    """Most views, spread evenly; all where absent."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        started = time.perf_counter()
        check_folder(self.output)
        with (
            progress_bars() as show,
            tempfile.TemporaryDirectory(prefix="splatwire-") as folder,
            self._explicit() as other,
        ):
            show("loading", 0.0)
            from splatwire.evaluate.study import (
                InProcess,
                MemoryStore,
                plain_content,
                run_loss_curve,
                run_study,
                write_report,
            )

            show("loading", 1.0)
            store = MemoryStore(Path(folder))
            result = run_study(self.study(), store, InProcess(_decode, show), show)
            content = plain_content(result)
            curve = run_loss_curve(result, store, InProcess(progress=show), show)
            links = {"The same with explicit Gaussians": "explicit/report.html"}
            report = write_report(result, store, self.output, content, curve=curve, links=links)
            show("explicit Gaussians, in another process", 0.0)
            explicit = other()
        seconds = time.perf_counter() - started
        if self.json:
            print_json({**content, "report": str(report), "demo_seconds": seconds, "explicit": explicit})
            return
        from splatwire.cli._table import print_rows

        print_rows(content["rows"], result.study.title, lpips_note=result.lpips_note)
        print(f"report: {report}")
        title = f"the same of explicit Gaussians, as any splat file holds them: {SPLATS}, made from the same photos"
        print_rows(explicit["rows"], title, lpips_note=result.lpips_note)
        print(f"report: {explicit['report']}")
        print(f"PSNR is against the lossless scene's own renders. {seconds:.0f} s in all.")

    @contextmanager
    def _explicit(self) -> Iterator[Callable[[], dict[str, Any]]]:
        """Has another process evaluate the bundled Gaussians meanwhile; what waits for its answer."""
        from splatwire.cli._fresh import in_fresh_process

        source = ASSETS / SPLATS
        views = () if self.views is None else ("--views", self.views)
        with in_fresh_process(
            "evaluate", source, "--reference", source, "--cameras", ASSETS / CAMERAS, "--loss", self.loss,
            "--seeds", self.seed, "--lpips-views", _LPIPS_VIEWS, *views, "-o", self.output / "explicit",
        ) as answer:  # fmt: skip
            yield answer

    def study(self) -> "Study":
        """What is compared."""
        from splatwire.codec import schema_named
        from splatwire.conceal import concealer_names
        from splatwire.evaluate.study import Loss, SceneEntry, Study, concealment_rows
        from splatwire.packets import read_stream
        from splatwire.packets.sections import sections_of

        source = ASSETS / SCENE
        stream, _ = read_stream(source)
        concealers = concealer_names(sections_of(stream), schema_named(stream.manifest.codec).offers)
        contiguous = replace(stream.manifest.packetization, grouping="contiguous")
        loss = Loss(self.loss)
        return Study(
            name=source.stem,
            title=f"splatwire demo: {source.stem} under {loss.process.name}",
            scenes=(SceneEntry(source.stem, source, "stream", cameras=ASSETS / CAMERAS),),
            rows=concealment_rows(concealers, contiguous=contiguous),
            losses=(loss,),
            seeds=(self.seed,),
            notes=_NOTES,
            baseline="drop",
            views=self.views,
            lpips_views=_LPIPS_VIEWS,
        )


def _decode(stream: "SceneStream") -> "Partial":
    """Decodes what arrived for the concealers in a fresh process; the other streams here, to save its start."""
    from splatwire.cli import _fresh
    from splatwire.codec import decode_stream

    manifest = stream.manifest
    here = len(stream.packets) == manifest.num_packets or manifest.packetization.grouping == "contiguous"
    return (decode_stream if here else _fresh.decode_in_fresh_process)(stream)
