"""The batched simulator: starts, memory, stepping, and observations as a graph."""

from fovconn_env.sim.graph import EDGE_COLUMNS, NODE_COLUMNS, Graph
from fovconn_env.sim.simulator import Simulator

__all__ = ["EDGE_COLUMNS", "NODE_COLUMNS", "Graph", "Simulator"]
