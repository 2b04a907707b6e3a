"""Importers: models that other programs trained, as scenes of ours."""

from splatwire.importers.hacpp import import_hacpp as import_hacpp
from splatwire.importers.scaffold import import_scaffold as import_scaffold
