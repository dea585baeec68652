"""Networks that treat neighbours and range points as sets, so that one policy fits any N and any order of rows.

Needs torch. The encoders are features extractors for Stable-Baselines3 (`features_extractor_class`). A trained network
is run by `policy`, without torch. Scales and units: `inputs`.
"""

from __future__ import annotations

import torch
from gymnasium import spaces
from torch import nn

from fovconn_env import layout
from fovconn_env.baselines.learned.inputs import EMPHASIS, LAMBDA2, OWN, POINT, ROW, SHARE, scales
from fovconn_env.errors import SettingError


def emphasis(lambda2: torch.Tensor) -> torch.Tensor:
    """Logarithm and inverse of lambda2_hat (R, 1), (R, 2): they resolve values near 0, where V is steep."""
    low = lambda2.clamp(min=0.0)
    return torch.cat([0.5 * torch.log(low + 0.05), 0.2 / (low + 0.1)], dim=1)


class Encoder(nn.Module):
    """Base of the encoders of scaled flat observations (R, D + extra). The extra columns belong to the own row."""

    def __init__(self, observation_space: spaces.Box, max_neighbors: int, extra: int) -> None:
        super().__init__()
        size = observation_space.shape[0] - extra
        self.max_neighbors, self.extra = max_neighbors, extra
        self.max_ranges = (size - OWN - max_neighbors * ROW) // POINT
        if self.max_ranges < 0 or layout.observation_size(max_neighbors, self.max_ranges) != size:
            raise SettingError(
                f"max_neighbors must fit an observation of {size} columns, got {max_neighbors}: "
                "take the scenario's max_neighbors"
            )
        self.own_size = OWN + EMPHASIS + extra
        self.scales: torch.Tensor
        divisors = torch.from_numpy(scales(max_neighbors, self.max_ranges, extra))
        self.register_buffer("scales", divisors, persistent=False)


class SetEncoder(Encoder):
    """Deep sets (Zaheer et al., NeurIPS 2017): a robot's own row, and sums over its neighbours and range points.

    Features [own, sum_j phi(row_j, own), sum_k rho(point_k)], over the rows in use. The paper's law is itself a sum
    over neighbours of such terms (5).
    """

    def __init__(
        self, observation_space: spaces.Box, max_neighbors: int = 8, extra: int = 0, width: int = 64, spots: int = 32
    ) -> None:
        super().__init__(observation_space, max_neighbors, extra)
        self.row = nn.Linear(ROW, width)
        self.own = nn.Linear(self.own_size, width, bias=False)
        self.term = nn.Linear(width, width)
        self.point = nn.Linear(POINT, spots)
        self.spot = nn.Linear(spots, spots)
        self.features_dim = self.own_size + width + spots

    def forward(self, flat: torch.Tensor) -> torch.Tensor:
        """Features (R, features_dim) of flat observations (R, D + extra)."""
        silu, scaled = nn.functional.silu, flat / self.scales
        first, last = OWN + self.max_neighbors * ROW, scaled.shape[1] - self.extra
        own = torch.cat([scaled[:, :OWN], emphasis(flat[:, LAMBDA2 : LAMBDA2 + 1]), scaled[:, last:]], dim=1)
        robot, rows = _used_rows(scaled[:, OWN:first].unflatten(1, (self.max_neighbors, ROW)))
        terms = silu(self.term(silu(self.row(rows) + self.own(own).index_select(0, robot))))
        owner, points = _used_rows(scaled[:, first:last].unflatten(1, (self.max_ranges, POINT)))
        spots = silu(self.spot(silu(self.point(points))))
        sums = [
            SHARE * part.new_zeros(len(flat), part.shape[1]).index_add(0, at, part)
            for at, part in ((robot, terms), (owner, spots))
        ]
        return torch.cat([own, *sums], dim=1)


class FlatEncoder(Encoder):
    """The scaled observation, for a plain multi-layer perceptron to compare with."""

    def __init__(self, observation_space: spaces.Box, max_neighbors: int = 8, extra: int = 0) -> None:
        super().__init__(observation_space, max_neighbors, extra)
        self.features_dim = observation_space.shape[0] + EMPHASIS

    def forward(self, flat: torch.Tensor) -> torch.Tensor:
        """Features (R, features_dim) of flat observations (R, D + extra): all columns, then the emphasis."""
        return torch.cat([flat / self.scales, emphasis(flat[:, LAMBDA2 : LAMBDA2 + 1])], dim=1)


ENCODERS: dict[str, type[Encoder]] = {"set": SetEncoder, "mlp": FlatEncoder}


def _used_rows(rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Robots (K,) and rows (K, n) of the K used rows of (R, M, n), in order of robots; unused rows cost no time."""
    robot, index = torch.nonzero(rows[..., 0], as_tuple=True)
    return robot, rows[robot, index]
