"""Schemas side by side, none of which imports another: which symbols an element is, under which integer models."""

from splatwire.codec.registry import register_schema
from splatwire.codec.schemas.causal.schema import SCHEMA as CAUSAL
from splatwire.codec.schemas.gaussians.schema import SCHEMA as GAUSSIANS
from splatwire.codec.schemas.hacpp.schema import SCHEMA as HACPP
from splatwire.codec.schemas.levels.schema import SCHEMA as LEVELS
from splatwire.codec.schemas.tracks.schema import SCHEMA as TRACKS

for _schema in (HACPP, CAUSAL, LEVELS, GAUSSIANS, TRACKS):  # levels are Gaussians, too
    register_schema(_schema)
