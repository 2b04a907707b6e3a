"""The same protocol on a real Ray with two workers on this machine."""

import pytest

from splatwire.evaluate.study import Store, load_study, run_study
from splatwire.evaluate.study.local_engine import LocalEngine
from splatwire.evaluate.study.ray_engine import RayEngine
from splatwire.evaluate.study.records import TIMINGS

ray = pytest.importorskip("ray")


@pytest.mark.filterwarnings("ignore")  # Ray's own start warns about itself
def test_ray_and_local_processes_give_identical_records(tiny_folder, tmp_path, monkeypatch):
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    study = load_study(tiny_folder / "protocol.toml")

    def records(name, engine):
        result = run_study(study, Store(tmp_path / name), engine, lambda task, share: None)
        assert result.num_computed == len(result.records)
        return [{k: v for k, v in record.items() if k not in TIMINGS} for record in result.merged()]

    assert records("ray", RayEngine(2)) == records("local", LocalEngine(2))
    assert not ray.is_initialized()
