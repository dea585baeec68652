"""Obstacles: authored, read from JSON or SVG, or drawn at random. The only importer of pymunk."""
