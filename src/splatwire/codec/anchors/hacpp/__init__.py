"""Codec `hacpp` (format 1) for neural anchors that are predicted from a binary hash grid in the side information.

It is named after the method HAC++ (paper arXiv:2501.12255, published with code), which trains such scenes.
"""
