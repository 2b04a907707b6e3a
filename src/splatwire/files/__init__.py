"""File access shared by all packages: format detection, bounded reading, safe names, atomic writing."""
