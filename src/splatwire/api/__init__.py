"""Main functions of splatwire: `encode`, `decode`, `evaluate`, `receive`, `serve`."""
