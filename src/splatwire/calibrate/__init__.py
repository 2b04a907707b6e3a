"""What a sender fits to its finished scene: the GNN's weights, a sketch, a preview; and the scene-free network."""
