"""Flights for other viewers: a web page of its own, and rerun."""
