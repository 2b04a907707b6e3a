"""A coarse copy of the anchors that matter most, sent with the side information and drawn where they are lost."""

from splatwire.conceal.sketch.concealer import Sketch as Sketch
from splatwire.conceal.sketch.section import SECTION as SECTION
