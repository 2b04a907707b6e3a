"""Format 1: HAC++'s anchors, predicted from a binary hash grid that all of them share (HACPP_SPEC)."""
