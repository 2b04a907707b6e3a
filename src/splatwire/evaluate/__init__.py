"""Evaluation: what is compared is data, methods share their losses, and a report shows pictures beside numbers."""

from splatwire.evaluate.protocol import Method as Method
from splatwire.evaluate.protocol import Protocol as Protocol
from splatwire.evaluate.protocol import concealment_methods as concealment_methods
from splatwire.evaluate.report import write_report as write_report
from splatwire.evaluate.results import Evaluation as Evaluation
from splatwire.evaluate.runner import evaluate_scene as evaluate_scene
from splatwire.evaluate.runner import evaluate_streams as evaluate_streams
from splatwire.evaluate.views import ReferenceViews as ReferenceViews
from splatwire.evaluate.views import photo_views as photo_views
from splatwire.evaluate.views import rendered_views as rendered_views
