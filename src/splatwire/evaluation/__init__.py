"""Evaluation of image quality under losses: methods are compared on the same loss masks and reference images."""

from splatwire.evaluation.views import ReferenceViews, photo_views

__all__ = ["ReferenceViews", "photo_views"]
