"""Codec `hacpp` (format 1) for neural anchors that are predicted from a binary hash grid in the side information.

HAC++ is the paper arXiv:2501.12255, with the code of its authors.
"""
