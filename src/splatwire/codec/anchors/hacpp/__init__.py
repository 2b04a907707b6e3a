"""Schema `hacpp` (format 1): anchors predicted from a binary hash grid, which is sent as side information.

In docstrings, HAC++ is the paper arXiv:2501.12255 and the behaviour of its authors' code.
"""
