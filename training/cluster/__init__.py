"""Flights on the machines of a Ray cluster. Only the functions here import ray, when they are called."""
