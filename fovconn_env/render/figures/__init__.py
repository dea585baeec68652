"""Figures, maps and animations of flights, by matplotlib."""
