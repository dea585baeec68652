"""SVG drawings as calls of Map's methods. Which elements are read, and how: docs/maps.md."""

from fovconn_env.maps.svg.reader import read_svg
from fovconn_env.maps.svg.shapes import TOLERANCE

__all__ = ["TOLERANCE", "read_svg"]
