"""SVG drawings as calls of Map's methods. Which elements are read, and how: docs/maps.md."""

from fovconn_env.maps.svg.reader import TOLERANCE, read_svg

__all__ = ["TOLERANCE", "read_svg"]
