"""Codec `causal` for neural anchors, whose attributes a causal model predicts (docs/format.md, format 2).

The causal model is a chain of small networks. Each network predicts some attributes of an anchor from its position and
its attributes decoded before.
"""
