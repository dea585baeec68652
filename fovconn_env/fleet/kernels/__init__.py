"""The two halves of a step, compiled: the world's and one robot's."""
