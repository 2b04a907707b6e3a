"""Importers: models that other programs trained, as scenes of ours; `hacpp` and `scaffold`, which need torch."""

from splatwire.packets import ANCHORS

HACPP_CODEC = ANCHORS
"""Codec of the scenes that `hacpp` and `scaffold` import."""
