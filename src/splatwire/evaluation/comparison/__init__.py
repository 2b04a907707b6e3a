"""Comparison of several files of one scene: bytes, image quality in held-out views, decoding time."""

from splatwire.evaluation.comparison.compare import Comparison as Comparison
from splatwire.evaluation.comparison.compare import FileScore as FileScore
from splatwire.evaluation.comparison.compare import compare_files as compare_files
from splatwire.evaluation.comparison.report import comparison_cells as comparison_cells
from splatwire.evaluation.comparison.report import comparison_content as comparison_content
from splatwire.evaluation.comparison.report import comparison_headings as comparison_headings
from splatwire.evaluation.comparison.report import write_comparison_report as write_comparison_report
