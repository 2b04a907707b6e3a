"""The concealer `sketch`: coarse copies in the side information replace the most important lost elements."""

from splatwire.concealment.sketch.concealer import Sketch as Sketch
from splatwire.concealment.sketch.section import SECTION as SECTION
