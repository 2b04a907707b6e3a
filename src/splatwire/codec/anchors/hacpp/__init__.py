"""Schema `hacpp` (format 1): anchors predicted from a binary hash grid, which is sent as side information.

HAC++ is the paper arXiv:2501.12255, with the code of its authors.
"""
