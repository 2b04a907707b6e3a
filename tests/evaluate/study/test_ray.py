"""The same protocol on a real Ray with two workers on this machine, and in this process."""

import pytest

from splatwire.evaluate.study import InProcess, Store, load_study, run_study
from splatwire.evaluate.study.ray_engine import RayEngine
from splatwire.evaluate.study.records import TIMINGS

ray = pytest.importorskip("ray")


@pytest.mark.filterwarnings("ignore")  # Ray's own start warns about itself
def test_ray_gives_identical_records(tiny_folder, tmp_path, monkeypatch):
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("RAY_worker_niceness", "0")  # else whatever else this machine does comes first
    study = load_study(tiny_folder / "protocol.toml")

    def records(name, engine):
        result = run_study(study, Store(tmp_path / name), engine, lambda task, share: None)
        assert result.num_computed == len(result.records)
        return [{k: v for k, v in record.items() if k not in TIMINGS} for record in result.merged()]

    assert records("ray", RayEngine(2)) == records("here", InProcess())
    assert not ray.is_initialized()
