"""The command `splatwire`: one file per subcommand."""

# Heavy libraries are loaded only by the subcommand that runs.

import resource
import sys

if resource.getrlimit(resource.RLIMIT_FSIZE)[0] != resource.RLIM_INFINITY:
    # Python would cut the compiled modules that it caches at the limit, and every later start would fail.
    sys.dont_write_bytecode = True
