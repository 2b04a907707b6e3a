"""Units of work: results, resuming, dying workers, and identical records from every engine."""

import dataclasses
import math
import multiprocessing

import numpy as np
import pytest

from splatwire.bitstream import read_stream, write_stream
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, repack
from splatwire.concealment import conceal
from splatwire.data import load_cameras
from splatwire.errors import SplatwireError
from splatwire.evaluation.study import InProcess, Store, create_engine, load_study, local_engine, run_study
from splatwire.evaluation.study.local_engine import LocalEngine
from splatwire.evaluation.study.records import TIMINGS
from splatwire.evaluation.study.slurm_engine import SlurmEngine
from splatwire.evaluation.study.slurm_options import SlurmOptions
from splatwire.evaluation.study.work import erode
from splatwire.metrics import psnr, ssim
from splatwire.render import render_scene
from splatwire.types import Attribute

pytestmark = [pytest.mark.slow, pytest.mark.needs_torch]


LIGHT = {"drop": "drop", "idw": "grow"}


def silent(task, share):
    pass


def plain(result):
    """Records without the fields that differ from run to run."""
    return [{key: value for key, value in record.items() if key not in TIMINGS} for record in result.merged()]


@pytest.fixture(scope="module")
def study(tiny_folder):
    return load_study(tiny_folder / "protocol.toml")


@pytest.fixture(scope="module")
def done(study, tmp_path_factory):
    store = Store(tmp_path_factory.mktemp("done"))
    return store, run_study(study, store, InProcess(), silent)


@pytest.fixture(scope="module")
def light(study):
    """The study without torch: its import takes seconds in each process that starts."""
    return dataclasses.replace(study, rows=tuple(dataclasses.replace(r, conceal=LIGHT[r.conceal]) for r in study.rows))


@pytest.fixture(scope="module")
def light_records(light, tmp_path_factory):
    return plain(run_study(light, Store(tmp_path_factory.mktemp("light")), InProcess(), silent))


def test_record_equals_calling_the_packages_step_by_step(done, tiny_folder):
    _, result = done
    whole = read_stream(tiny_folder / "tiny.swz")[0]
    stream = repack(whole, result.study.row("idw").packetization)
    received, record = transmit(stream, parse_loss("bernoulli:0.3"), seed=3)
    cameras = load_cameras(tiny_folder / "cameras.json")
    reference = render_scene(decode_stream(whole).scene, cameras)
    images = render_scene(conceal(decode_stream(received), "idw"), cameras)
    found = [r for r in result.merged() if (r["row"], r["seed"]) == ("idw", 3)]
    assert [r["psnr"] for r in found] == pytest.approx(psnr(images, reference).tolist(), abs=1e-4)
    assert [r["ssim"] for r in found] == pytest.approx(ssim(images, reference).tolist(), abs=1e-5)
    assert [r["num_lost_packets"] for r in found] == [record.num_lost] * 2
    assert found[0]["num_bytes_received"] == received.num_bytes
    assert [r["view"] for r in found] == list(cameras.names)


def test_without_loss_pictures_equal_their_references(done):
    found = [r for r in done[1].merged() if r["row"] == "reference"]
    assert len(found) == 2
    assert all(math.isinf(r["psnr"]) and r["ssim"] == 1 and r["seed"] is None for r in found)


def test_methods_share_loss_masks(done):
    masks = {(r["row"], r["seed"]): r["mask"] for r in done[1].merged()}
    assert masks[("drop", 0)] == masks[("idw", 0)] == masks[("contiguous", 0)] != masks[("drop", 3)]


def test_finished_tasks_are_not_computed_again(done, study):
    store, first = done
    again = run_study(study, store, InProcess(), silent)
    assert (again.num_computed, again.num_reused) == (0, first.num_computed)
    assert again.merged() == first.merged()
    more = run_study(dataclasses.replace(study, seeds=(0, 3, 4)), store, InProcess(), silent)
    assert more.num_computed == len(study.lossy_rows)


def test_interrupted_run_resumes_without_duplicate_records(study, tmp_path, done):
    class Interrupted(InProcess):
        def run(self, store, units, listener):
            super().run(store, units[:3], listener)
            raise KeyboardInterrupt

    store = Store(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        run_study(study, store, Interrupted(), silent)
    resumed = run_study(study, store, InProcess(), silent)
    assert resumed.num_reused == 3
    assert plain(resumed) == plain(done[1])
    places = [(r["row"], r["seed"], r["view"]) for r in resumed.merged()]
    assert len(places) == len(set(places)) == 2 * (3 * 2 + 1)


def test_damaged_unit_is_reported(study, tmp_path):
    store = Store(tmp_path)
    result = run_study(study, store, InProcess(), silent)
    path = store.unit_path(result.cells[0].unit.key)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(SplatwireError, match=r"\.parquet is not a file of records.*remove it"):
        run_study(study, store, InProcess(), silent)


def test_eroded_attributes_are_hidden_from_concealers(done, tiny_folder):
    whole = decode_stream(read_stream(tiny_folder / "tiny.swz")[0])
    lost = np.zeros(180, np.bool_)
    lost[::4] = True
    eroded = erode(whole, lost, Attribute.SCALING)
    assert np.array_equal(eroded.loss_mask.column(Attribute.SCALING), ~lost)
    for other in (Attribute.FEATURE, Attribute.OFFSET, Attribute.MASK):
        assert bool(eroded.loss_mask.column(other).all())
    before, after = whole.scene.anchors, eroded.scene.anchors
    assert not bool(after.scalings[lost].any())
    assert np.array_equal(after.scalings[~lost], before.scalings[~lost])
    assert np.array_equal(after.features, before.features)
    assert np.array_equal(after.offsets, before.offsets)
    filled = conceal(eroded, "idw").anchors
    assert np.array_equal(filled.features, before.features)
    assert bool((filled.scalings[lost] != 0).all())


def test_local_workers_give_identical_records_despite_a_killed_worker(light, tmp_path, light_records):
    killed = []

    def kill_one(task, share):
        if "units" in task and not killed:
            killed.append(multiprocessing.active_children()[0])
            killed[0].kill()

    result = run_study(light, Store(tmp_path), LocalEngine(2), kill_one)
    assert plain(result) == light_records
    assert killed
    assert result.num_lost_workers <= 1  # the kill may have hit an idle worker


def test_repeatedly_killed_worker_ends_the_run(tmp_path, done, monkeypatch):
    units = [cell.unit for cell in done[1].cells if cell.row.key == "drop"][:1]
    lost = []

    def listen(event):
        lost.append(event.lost_worker)

    start = local_engine._Worker.start

    def start_and_kill(root):
        worker = start(root)
        worker.process.kill()
        worker.process.join()
        return worker

    monkeypatch.setattr(local_engine._Worker, "start", staticmethod(start_and_kill))
    with pytest.raises(SplatwireError, match=r"drop.*its worker died 3 times.*finished units are kept"):
        LocalEngine(1).run(Store(tmp_path), units, listen)
    assert lost == [True] * 3


def test_workers_import_no_module_from_the_current_folder(tmp_path, done, monkeypatch):
    unit = done[1].cells[-1].unit
    unit = dataclasses.replace(unit, stream=dataclasses.replace(unit.stream, path="inputs/absent.swz"))
    (tmp_path / "pickle.py").write_text("raise SystemExit('the module of the folder was imported')\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SplatwireError, match=r"absent\.swz"):  # a worker that cannot start would be "died 3 times"
        LocalEngine(1).run(Store(tmp_path), [unit], lambda event: None)


def test_a_unit_that_fails_ends_the_run_with_its_name(tmp_path, done):
    unit = done[1].cells[-1].unit
    unit = dataclasses.replace(unit, stream=dataclasses.replace(unit.stream, path="inputs/absent.swz"))
    with pytest.raises(SplatwireError, match=r"scene made up.*idw.*absent\.swz"):
        LocalEngine(1).run(Store(tmp_path), [unit], lambda event: None)


def test_slurm_jobs_give_identical_records(light, tmp_path, light_records):
    pytest.importorskip("submitit")
    result = run_study(light, Store(tmp_path), SlurmEngine(2, cluster="local"), silent)
    assert plain(result) == light_records


def test_slurm_jobs_have_partition_account_time_and_memory(monkeypatch):
    submitit = pytest.importorskip("submitit")
    monkeypatch.setattr("shutil.which", lambda name: f"/usr/bin/{name}")
    options = SlurmOptions(partition="gpu", account="lab", minutes=30, memory_gb=16)
    engine, usual = create_engine("slurm", 3, options), create_engine("slurm", 3)
    assert isinstance(engine, SlurmEngine)
    assert isinstance(usual, SlurmEngine)
    assert engine.parameters() == {
        "timeout_min": 30, "mem_gb": 16, "slurm_array_parallelism": 3, "slurm_partition": "gpu", "slurm_account": "lab"
    }  # fmt: skip
    assert usual.parameters() == {"timeout_min": 240, "mem_gb": 8, "slurm_array_parallelism": 3}
    executor = submitit.AutoExecutor(folder="jobs", cluster="slurm")
    executor.update_parameters(name="splatwire", **engine.parameters())
    wanted = {"partition": "gpu", "account": "lab", "time": 30, "mem": "16GB"}
    assert {name: executor._executor.parameters[name] for name in wanted} == wanted


def test_slurm_without_sbatch_is_refused_before_the_work(monkeypatch):
    pytest.importorskip("submitit")
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(SplatwireError, match="no sbatch"):
        create_engine("slurm")


def test_slurm_jobs_that_are_refused_are_an_error_and_the_others_are_cancelled(monkeypatch, tmp_path, done):
    """A wrong partition; programs in place of those of Slurm accept the first job only."""
    pytest.importorskip("submitit")
    programs = {
        "sbatch": """if [ -e submitted ]; then echo "sbatch: error: invalid partition specified: gpuu" >&2; exit 1; fi
touch submitted; echo Submitted batch job 17""",
        "srun": "exit 1",
        "sacct": "echo",
        "scancel": "echo $* >> cancelled",
    }
    for name, text in programs.items():
        (tmp_path / name).write_text(f"#!/bin/sh\ncd {tmp_path}\n{text}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    units = list({cell.unit.key: cell.unit for cell in done[1].cells}.values())[:2]
    with pytest.raises(SplatwireError, match=r"the job was refused: .*invalid partition specified: gpuu"):
        SlurmEngine(2, options=SlurmOptions(partition="gpuu")).run(Store(tmp_path / "store"), units, lambda event: None)
    assert (tmp_path / "cancelled").read_text() == "17\n"


def test_a_scene_that_cannot_be_used_is_refused_before_the_work(study, tmp_path, tiny_folder):
    stream, _ = read_stream(tiny_folder / "tiny.swz")
    write_stream(transmit(stream, "bernoulli:0.5", seed=1)[0], tmp_path / "lossy.swz")
    (tmp_path / "cameras.json").write_text("[]")
    good = study.scenes[0]
    steps = []
    for change, message in (
        (
            {"source": tmp_path / "lossy.swz"},
            r"lossy\.swz: \d+ of \d+ packets are missing, and rows put the scene 'other'",
        ),
        ({"cameras": tmp_path / "cameras.json"}, "cameras.json: has no views"),
    ):
        other = dataclasses.replace(good, name="other", **change)
        with pytest.raises(SplatwireError, match=message):
            run_study(
                dataclasses.replace(study, scenes=(good, other)),
                Store(tmp_path / "store"),
                InProcess(),
                lambda task, share: steps.append(task),
            )
    assert not steps


@pytest.mark.parametrize(
    ("options", "reason"),
    [({"minutes": 0}, "minutes"), ({"memory_gb": -1}, "memory_gb"), ({"partition": ""}, "partition"),
     ({"account": "a b"}, "account")],
)  # fmt: skip
def test_options_of_slurm_are_checked(options, reason):
    with pytest.raises(SplatwireError, match=reason):
        SlurmOptions(**options)


def test_other_engines_refuse_options_of_slurm():
    with pytest.raises(SplatwireError, match="for engine 'slurm'"):
        create_engine("local", 1, SlurmOptions(partition="gpu"))


def test_engines_refuse_invalid_options():
    with pytest.raises(SplatwireError, match="unknown engine 'moon'"):
        create_engine("moon")
    with pytest.raises(SplatwireError, match="at least one worker"):
        create_engine("local", 0)
