"""Flights for other viewers: a web page, and rerun."""
