"""Format 1: HAC++'s anchors, predicted from a binary hash grid that all of them share.

HAC++ is arXiv:2501.12255; in docstrings its name stands for that paper and for what its authors' code does.
"""
