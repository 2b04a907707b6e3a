"""Functions that most programs need, under short names: `splatwire.encode`, `decode`, `evaluate`, `receive`, `serve`.

They combine functions of the other packages. `import splatwire` offers their names.
"""
