"""Adapters: PettingZoo, Gymnasium (joint and vector), and what they render."""
