"""Files of explicit Gaussians: a file a format, both directions, told by first bytes."""

from splatwire.formats.kinds import read_splats as read_splats
from splatwire.formats.kinds import splats_kind as splats_kind
from splatwire.formats.kinds import write_splats as write_splats
from splatwire.formats.kinds import writer_for as writer_for
