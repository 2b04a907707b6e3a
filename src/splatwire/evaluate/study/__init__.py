"""Evaluations as data: scenes, rows, losses and seeds become units of work that run anywhere, into one store."""

from splatwire.evaluate.study.curve import run_loss_curve as run_loss_curve
from splatwire.evaluate.study.definition import Loss as Loss
from splatwire.evaluate.study.definition import Row as Row
from splatwire.evaluate.study.definition import SceneEntry as SceneEntry
from splatwire.evaluate.study.definition import Study as Study
from splatwire.evaluate.study.engine_names import create_engine as create_engine
from splatwire.evaluate.study.engines import InProcess as InProcess
from splatwire.evaluate.study.outputs import write_outputs as write_outputs
from splatwire.evaluate.study.outputs import write_report as write_report
from splatwire.evaluate.study.outputs import write_size_outputs as write_size_outputs
from splatwire.evaluate.study.plain import concealment_rows as concealment_rows
from splatwire.evaluate.study.plain import plain_content as plain_content
from splatwire.evaluate.study.run import StudyResult as StudyResult
from splatwire.evaluate.study.run import run_study as run_study
from splatwire.evaluate.study.sizes import measure_study_sizes as measure_study_sizes
from splatwire.evaluate.study.store import MemoryStore as MemoryStore
from splatwire.evaluate.study.store import Store as Store
from splatwire.evaluate.study.summary import summarize as summarize
from splatwire.evaluate.study.toml_file import load_study as load_study
