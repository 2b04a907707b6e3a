"""Exporters: scenes of ours as files that other programs open."""

from splatwire.exporters.fit import FitCounts as FitCounts
from splatwire.exporters.fit import fit_splats as fit_splats
from splatwire.exporters.ply import write_ply as write_ply
from splatwire.exporters.splat import write_splat as write_splat
