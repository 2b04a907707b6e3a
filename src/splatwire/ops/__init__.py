"""Stateless array functions."""
