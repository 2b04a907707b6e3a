"""The script in `examples` runs as its documentation says."""

import runpy
from pathlib import Path

import pytest

import splatwire
from splatwire.concealment import concealer_names

REPOSITORY = Path(__file__).parents[2]
ASSETS = Path(splatwire.__file__).parent / "assets"


@pytest.mark.slow
@pytest.mark.needs_torch
def test_example_prints_one_line_for_each_concealer(capsys: pytest.CaptureFixture[str]) -> None:
    main = runpy.run_path(str(REPOSITORY / "examples" / "lose_and_conceal.py"))["main"]
    stream = REPOSITORY / "tests" / "golden" / "tiny_causal.swz"
    main(str(stream), str(ASSETS / "snowmiku_cameras.json"), "bernoulli:0.3")
    first, *rows = capsys.readouterr().out.splitlines()
    assert first.endswith("lost")
    received = splatwire.decode_stream(splatwire.read_stream(stream)[0])
    assert [row.split()[0] for row in rows] == list(concealer_names(received.sections, received.provides))
