"""Updates: streams that contain only the changes of another stream of Gaussians."""
