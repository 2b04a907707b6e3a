"""Exporters: scenes of ours as explicit Gaussians, which other programs open."""

from splatwire.exporters.fit import FitCounts as FitCounts
from splatwire.exporters.fit import fit_splats as fit_splats
