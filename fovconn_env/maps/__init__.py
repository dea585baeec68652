"""Obstacles: authored, read from JSON or SVG, or drawn at random. The only importer of pymunk."""

from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.maps.report import MapReport

__all__ = ["Corridor", "Forest", "Map", "MapReport"]
