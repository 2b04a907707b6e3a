"""The same protocol on local Ray with two workers, and in this process."""

import pytest

from splatwire.evaluation.study import InProcess, Store, load_study, run_study
from splatwire.evaluation.study.ray_engine import RayEngine
from splatwire.evaluation.study.records import TIMINGS

pytestmark = [pytest.mark.slow, pytest.mark.needs_torch]


@pytest.mark.filterwarnings("ignore")  # Ray's own start emits warnings
def test_ray_gives_identical_records(tiny_folder, tmp_path, monkeypatch):
    ray = pytest.importorskip("ray")  # here, because its import takes a second in every process that collects tests
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("RAY_worker_niceness", "0")  # otherwise other load on this machine delays the workers
    study = load_study(tiny_folder / "protocol.toml")

    def records(name, engine):
        result = run_study(study, Store(tmp_path / name), engine, lambda task, share: None)
        assert result.num_computed == len(result.records)
        return [{k: v for k, v in record.items() if k not in TIMINGS} for record in result.merged()]

    assert records("ray", RayEngine(2)) == records("here", InProcess())
    assert not ray.is_initialized()
