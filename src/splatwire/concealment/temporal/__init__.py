"""Concealers for sequences: estimate lost motion from earlier frames and from neighbouring tracks."""
