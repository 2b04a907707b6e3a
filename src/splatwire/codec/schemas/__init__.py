"""Schemas side by side, none of which imports another: which symbols an element is, under which integer models."""
