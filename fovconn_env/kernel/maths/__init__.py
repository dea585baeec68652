"""Formulas without state: geometry, spectrum, weights, counter-based random numbers."""
