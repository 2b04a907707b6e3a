"""Code that needs PyTorch: training, import of trained models, networks of neural anchors, differentiable renderers."""
