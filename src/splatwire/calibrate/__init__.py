"""What a sender fits to its finished scene: a sketch, a preview; and the scene-free network."""
