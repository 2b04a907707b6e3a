"""Export of neural scenes as explicit Gaussians for other programs."""
