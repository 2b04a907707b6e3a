"""Schema `causal`: anchors under the causal model (docs/format.md, format 2)."""
