"""Flights: records of an episode, recordings that replay bit for bit, metrics."""
