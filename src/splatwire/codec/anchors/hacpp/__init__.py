"""Format 1: HAC++'s anchors, predicted from a shared binary hash grid.

In docstrings, HAC++ is the paper arXiv:2501.12255 and the behaviour of its authors' code.
"""
