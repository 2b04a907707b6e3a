"""Implementation of `splatwire verify`: checks whether streams are intact and complete."""

from pathlib import Path
from typing import Any

from splatwire.bitstream import read_stream
from splatwire.cli._files import STANDARD, check_inputs, input_path, read_report_json
from splatwire.cli._input_warnings import DAMAGED
from splatwire.cli._output import print_json
from splatwire.cli.verify import Verify
from splatwire.codec.decoding import open_decoder
from splatwire.codec.memory import allocating
from splatwire.errors import BitstreamError, InvalidValueError


def run(command: Verify) -> None:
    """Runs `splatwire verify`: checks streams without decoding them."""
    if not command.streams:
        raise InvalidValueError("name a stream to verify")
    check_inputs(*(Path(name) for name in command.streams if name != STANDARD))
    results = {name: _check(command, name) for name in dict.fromkeys(command.streams)}
    good = all(facts["ok"] for facts in results.values())
    if command.json:
        print_json({"ok": good, "streams": results})
    else:
        for name, facts in results.items():
            _print_facts(name, facts)
    if not good:
        raise SystemExit(DAMAGED)


def _check(command: Verify, name: str) -> dict[str, Any]:
    try:
        with input_path(name) as path:
            stream, report = read_stream(path)
        with allocating("reading the side information"):
            open_decoder(stream.manifest, stream.side_info, stream.num_bytes)  # checks it
    except BitstreamError as error:
        return {"ok": False, "intact": False, "problems": [str(error)]}
    intact = report.num_corrupt == report.num_foreign == report.num_duplicate == 0
    return {"ok": intact and (report.complete or command.accept_losses), "intact": intact, **read_report_json(report)}


def _print_facts(name: str, facts: dict[str, Any]) -> None:
    if "num_expected" not in facts:
        print(f"{name}: not ok: {facts['problems'][0].removeprefix(f'{name}: ')}")
        return
    kinds = [kind for kind in ("missing", "corrupt", "foreign", "duplicate") if facts[f"num_{kind}"]]
    state = "ok" if facts["ok"] else "incomplete" if facts["intact"] else "damaged"
    counts = [f"{facts['num_received']:,} of {facts['num_expected']:,} packets are good"]
    print(f"{name}: {state}: " + ", ".join(counts + [f"{facts[f'num_{kind}']:,} {kind}" for kind in kinds]))
    for problem in facts["problems"]:
        print(f"  {problem}")
