"""Evaluation: what is compared is data (`splatwire.evaluate.study`), and rows share their losses and references."""

from splatwire.evaluate.views import ReferenceViews, photo_views

__all__ = ["ReferenceViews", "photo_views"]
