"""Observations as a graph for graph networks: robots are nodes, neighbour rows are edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fovconn_env import layout
from fovconn_env.kernel.records import State

NODE_COLUMNS = tuple(column.name for column in layout.SELF)
"""Names of the columns of `Graph.nodes`."""
EDGE_COLUMNS = tuple(column.name for column in layout.NEIGHBOR if column.name != "present")
"""Names of the columns of `Graph.edges`."""


class Graph(NamedTuple):
    """Observations of V robots as a directed graph with E edges. The arrays are copies.

    Edge e holds what robot `edge_index[1, e]` knows about robot `edge_index[0, e]`. It points from the observed robot
    to its observer, the direction of its messages, as in torch_geometric and DGL.
    """

    nodes: np.ndarray  # (V, F) float32, NODE_COLUMNS: the robots' own rows
    edges: np.ndarray  # (E, C) float32, EDGE_COLUMNS: the observers' neighbour rows
    edge_index: np.ndarray  # (2, E) int64: observed, observer; sorted by observer, nearest first
    batch: np.ndarray  # (V,) int64, the world of each node, counted from 0


def observed_graph(state: State, worlds: slice) -> Graph:
    """The graph of these worlds, side by side: robot i of the b-th of them is node b N + i.

    Nodes and edges hold the observations alone. Rows have no identities; the edges' ends come from the on-board tracks,
    where camera and messages have them.
    """
    own, rows, tracks = state.own_row[worlds], state.neighbor_row[worlds], state.track[worlds]
    n_worlds, n = own.shape
    used = rows["present"] > 0.0
    distance = np.where(tracks["present"], tracks["distance"], np.inf)
    nearest = np.argsort(distance, axis=-1, kind="stable")  # the order of the rows: by (distance, index)
    b, i, k = np.nonzero(used)
    nodes = np.stack([own[name].ravel() for name in NODE_COLUMNS], axis=-1)
    edges = np.stack([rows[name][used] for name in EDGE_COLUMNS], axis=-1)
    edge_index = np.stack([b * n + nearest[b, i, k], b * n + i])
    return Graph(nodes, edges, edge_index, np.repeat(np.arange(n_worlds), n))
