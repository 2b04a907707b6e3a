"""Main functions of splatwire: `encode`, `decode`, `evaluate`, `receive`, `serve`.

They combine functions of the other packages, and `import splatwire` offers their names.
"""
