"""Exporters: scenes of ours as explicit Gaussians, which other programs open; `splatwire.exporters.fit` needs torch."""
