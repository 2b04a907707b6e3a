"""Format 2: explicit Gaussians, each packet with the places of its own and predicted from what it decoded before."""
