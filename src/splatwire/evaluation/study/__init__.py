"""Evaluations (studies) that compare methods on the same scenes under the same losses of packets.

Each combination of scene, method, loss and seed is an independent task. Its result is stored, so an interrupted
evaluation can be resumed.
"""

from splatwire.evaluation.study.curve import run_loss_curve as run_loss_curve
from splatwire.evaluation.study.definition import Decoded as Decoded
from splatwire.evaluation.study.definition import Loss as Loss
from splatwire.evaluation.study.definition import Row as Row
from splatwire.evaluation.study.definition import SceneEntry as SceneEntry
from splatwire.evaluation.study.definition import Study as Study
from splatwire.evaluation.study.engine_names import create_engine as create_engine
from splatwire.evaluation.study.engines import InProcess as InProcess
from splatwire.evaluation.study.outputs import write_outputs as write_outputs
from splatwire.evaluation.study.outputs import write_report as write_report
from splatwire.evaluation.study.outputs import write_size_outputs as write_size_outputs
from splatwire.evaluation.study.plain import concealment_rows as concealment_rows
from splatwire.evaluation.study.plain import plain_content as plain_content
from splatwire.evaluation.study.plain_run import plain_rows as plain_rows
from splatwire.evaluation.study.plain_run import run_plain_study as run_plain_study
from splatwire.evaluation.study.run import StudyResult as StudyResult
from splatwire.evaluation.study.run import run_study as run_study
from splatwire.evaluation.study.sizes import measure_study_sizes as measure_study_sizes
from splatwire.evaluation.study.store import MemoryStore as MemoryStore
from splatwire.evaluation.study.store import Store as Store
from splatwire.evaluation.study.summary import summarize as summarize
from splatwire.evaluation.study.toml_file import load_study as load_study
