"""Codec `causal` for neural anchors, whose attributes a causal model predicts (docs/format.md, format 2).

The causal model is a chain of small networks. Each network predicts some attributes of an anchor from the anchor's
position and from those attributes that are already decoded.
"""
