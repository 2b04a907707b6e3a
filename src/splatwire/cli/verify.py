"""`splatwire verify`: are streams intact and complete?"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from splatwire.cli._files import STANDARD, check_inputs, input_path, read_report_json
from splatwire.cli._output import DAMAGED, JsonFlag, print_json
from splatwire.errors import BitstreamError, InvalidValueError


@dataclass(frozen=True)
class Verify:
    """Check streams: container, manifest, side information, checksum of each packet, and that no packet is missing.

    Nothing is decoded. The exit status is 3 if one stream is damaged or incomplete.
    """

    streams: tyro.conf.Positional[tuple[str, ...]]
    """Streams: .swz files, .glb files with a stream, or folders; - for standard input."""
    accept_losses: bool = False
    """Take a stream as good although packets are missing, as after `transmit`; damaged bytes still fail."""
    json: JsonFlag = False
    """Print one JSON object."""

    def run(self) -> None:
        """Runs the verb."""
        if not self.streams:
            raise InvalidValueError("name a stream to verify")
        check_inputs(*(Path(name) for name in self.streams if name != STANDARD))
        found = {name: self._check(name) for name in self.streams}
        good = all(facts["ok"] for facts in found.values())
        if self.json:
            print_json({"ok": good, "streams": found})
        else:
            for name, facts in found.items():
                _print_facts(name, facts)
        if not good:
            raise SystemExit(DAMAGED)

    def _check(self, name: str) -> dict[str, Any]:
        from splatwire.packets import read_stream

        try:
            with input_path(name) as path:
                report = read_stream(path)[1]
        except BitstreamError as error:
            return {"ok": False, "intact": False, "problems": [str(error)]}
        intact = report.num_corrupt == report.num_foreign == report.num_duplicate == 0
        return {"ok": intact and (report.complete or self.accept_losses), "intact": intact, **read_report_json(report)}


def _print_facts(name: str, facts: dict[str, Any]) -> None:
    if "num_expected" not in facts:
        print(f"{name}: not ok: {facts['problems'][0]}")
        return
    kinds = [kind for kind in ("missing", "corrupt", "foreign", "duplicate") if facts[f"num_{kind}"]]
    state = "ok" if facts["ok"] else "incomplete" if facts["intact"] else "damaged"
    counts = [f"{facts['num_received']:,} of {facts['num_expected']:,} packets are good"]
    print(f"{name}: {state}: " + ", ".join(counts + [f"{facts[f'num_{kind}']:,} {kind}" for kind in kinds]))
    for problem in facts["problems"]:
        print(f"  {problem}")
