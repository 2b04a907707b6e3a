from splatwire.rate_control.encoding import EFFORTS as EFFORTS
from splatwire.rate_control.encoding import EncodedScene as EncodedScene
from splatwire.rate_control.encoding import encode_controlled as encode_controlled
from splatwire.rate_control.targets import Target as Target
from splatwire.rate_control.targets import parse_size as parse_size
from splatwire.rate_control.tuning import Tuning as Tuning
