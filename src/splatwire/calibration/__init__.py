"""Computation of optional side information for a finished scene, by the sender before transmission.

A sketch consists of coarse copies of the most important elements, for the concealment of losses. A preview consists of
a few explicit Gaussians that a receiver draws first.
"""
