"""Importers of models trained with other programs: `hacpp` and `scaffold`. Both need torch."""
