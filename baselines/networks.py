"""Networks that treat neighbours and range points as sets, so that one policy fits any N and any order of rows.

Needs torch. `SetEncoder` and `FlatEncoder` are features extractors for Stable-Baselines3 (`features_extractor_class`);
what comes out of the training is flown by `learned`, without torch.
"""

from __future__ import annotations

import numpy as np
import torch
from gymnasium import spaces
from torch import nn

from fovconn_env import layout
from fovconn_env.scenarios import Scenario

OWN, ROW, POINT = len(layout.SELF), len(layout.NEIGHBOR), len(layout.RANGE)
SHARE = 0.3  # of a sum over rows, so that three rows make about one
_LAMBDA2 = [column.name for column in layout.SELF].index("lambda2_hat")
# Scales that do not depend on N; columns that stay far within their bounds get narrower ones.
_SCALES = {**Scenario().scales(), "lambda2": 3.0, "speed": 1.5, "turn": 1.0}
_NARROW = {"v2_hat": 0.5, "roll": 0.3, "pitch": 0.3}


def scales(max_neighbors: int, max_ranges: int) -> np.ndarray:
    """What the columns of a flat observation are divided by, (D,) float32: their bounds in `layout`, or less."""

    def of(table: tuple[layout.Column, ...]) -> list[float]:
        return [_NARROW.get(column.name, high) for column, high in zip(table, layout.bounds(table, _SCALES)[1], strict=True)]

    rows = of(layout.SELF) + max_neighbors * of(layout.NEIGHBOR) + max_ranges * of(layout.RANGE)
    return np.array(rows, np.float32)


def emphasis(lambda2: torch.Tensor) -> torch.Tensor:
    """lambda2_hat (R, 1) spread out near 0, where V' is steep: its logarithm and its inverse, (R, 2)."""
    low = lambda2.clamp(min=0.0)
    return torch.cat([0.5 * torch.log(low + 0.05), 0.2 / (low + 0.1)], dim=1)


class SetEncoder(nn.Module):
    """Deep sets (Zaheer et al., NeurIPS 2017): a robot's own row, and sums over its neighbours and range points.

    Features [own, sum_j phi(row_j, own), sum_k rho(point_k)], over the rows in use. The paper's law is itself a sum over
    neighbours of such terms (5).
    """

    def __init__(self, observation_space: spaces.Box, max_neighbors: int = 8, width: int = 64, spots: int = 32) -> None:
        super().__init__()
        size = observation_space.shape[0]
        self.max_neighbors, self.max_ranges = max_neighbors, (size - OWN - max_neighbors * ROW) // POINT
        if layout.observation_size(self.max_neighbors, self.max_ranges) != size:
            raise ValueError(f"max_neighbors must fit an observation of {size} columns, got {max_neighbors}")
        self.scales: torch.Tensor
        self.register_buffer("scales", torch.from_numpy(scales(max_neighbors, self.max_ranges)), persistent=False)
        self.row = nn.Linear(ROW, width)
        self.own = nn.Linear(OWN + 2, width, bias=False)
        self.term = nn.Linear(width, width)
        self.point = nn.Linear(POINT, spots)
        self.spot = nn.Linear(spots, spots)
        self.features_dim = OWN + 2 + width + spots

    def forward(self, flat: torch.Tensor) -> torch.Tensor:
        """Features (R, features_dim) of flat observations (R, D)."""
        silu, scaled, end = nn.functional.silu, flat / self.scales, OWN + self.max_neighbors * ROW
        own = torch.cat([scaled[:, :OWN], emphasis(flat[:, _LAMBDA2 : _LAMBDA2 + 1])], dim=1)
        rows = scaled[:, OWN:end].unflatten(1, (self.max_neighbors, ROW))
        points = scaled[:, end:].unflatten(1, (self.max_ranges, POINT))
        terms = silu(self.term(silu(self.row(rows) + self.own(own)[:, None])))
        spots = silu(self.spot(silu(self.point(points))))
        sums = [SHARE * (part * used[..., :1]).sum(1) for part, used in ((terms, rows), (spots, points))]
        return torch.cat([own, *sums], dim=1)


class FlatEncoder(nn.Module):
    """The scaled observation as it is, for a plain multi-layer perceptron: to compare with."""

    def __init__(self, observation_space: spaces.Box, max_neighbors: int = 8) -> None:
        super().__init__()
        size = observation_space.shape[0]
        self.scales: torch.Tensor
        max_ranges = (size - OWN - max_neighbors * ROW) // POINT
        self.register_buffer("scales", torch.from_numpy(scales(max_neighbors, max_ranges)), persistent=False)
        self.features_dim = size

    def forward(self, flat: torch.Tensor) -> torch.Tensor:
        """Features (R, D) of flat observations (R, D)."""
        return flat / self.scales
