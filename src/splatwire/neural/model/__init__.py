"""Networks of neural anchors in torch: hash grid, prior, channel context, and heads that generate Gaussians."""
