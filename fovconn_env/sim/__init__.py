"""The batched simulator: starts, memory, stepping, and observations as a graph."""
