"""Strokes and the geometry they share: lengths, distances, joins."""
