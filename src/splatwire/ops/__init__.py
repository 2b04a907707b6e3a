"""Stateless numerical functions on arrays."""
