"""Evaluation: what is compared is data, methods share their losses, and a report shows pictures beside numbers."""

from splatwire.evaluate.protocol import Method, Protocol, concealment_methods
from splatwire.evaluate.report import write_report
from splatwire.evaluate.results import Evaluation
from splatwire.evaluate.runner import evaluate_scene, evaluate_streams
from splatwire.evaluate.views import ReferenceViews, photo_views, rendered_views

__all__ = [
    "Evaluation",
    "Method",
    "Protocol",
    "ReferenceViews",
    "concealment_methods",
    "evaluate_scene",
    "evaluate_streams",
    "photo_views",
    "rendered_views",
    "write_report",
]
