"""Renderers in torch: a readable reference, a differentiable CPU renderer, and a GPU renderer (gsplat)."""
