"""Sequences of moving Gaussians: encoding by group of pictures, and decoding by frame.

Submodules are imported when one of their names is first used. Checking if a path is a sequence (`is_sequence`) thus
does not import encoder and decoder.
"""

from splatwire.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
