"""Networks that treat neighbours and range points as sets, so that one policy fits any N and any order of rows.

Needs torch. The encoders are features extractors for Stable-Baselines3 (`features_extractor_class`). A trained network
is run by `policy`, without torch. Scales and units: `inputs`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from torch import nn

from fovconn_env import layout
from fovconn_env.baselines.learned.inputs import EMPHASIS, LAMBDA2, OWN, POINT, ROW, scales
from fovconn_env.baselines.learned.sets import (
    activate_with,
    add_up,
    collect_gradient,
    copy_chosen,
    copy_used,
    count_used,
    spread_gradient,
)
from fovconn_env.errors import SettingError


def emphasis(lambda2: torch.Tensor) -> torch.Tensor:
    """Logarithm and inverse of lambda2_hat (R, 1), (R, 2): they resolve values near 0, where V is steep."""
    low = lambda2.clamp(min=0.0)
    return torch.cat([0.5 * torch.log(low + 0.05), 0.2 / (low + 0.1)], dim=1)


class RowList(NamedTuple):
    """The rows in use of all robots, a CSR list: `rows` (K, n), those of robot r from starts[r] to starts[r + 1]."""

    rows: torch.Tensor
    starts: np.ndarray  # (R + 1,) int64

    def take(self, chosen: np.ndarray) -> RowList:
        """Those of the chosen robots, copied."""
        starts = np.concatenate([np.zeros(1, np.int64), np.cumsum(np.diff(self.starts)[chosen])])
        copies = self.rows.new_empty(int(starts[-1]), self.rows.shape[1])
        copy_chosen(self.rows.numpy(), self.starts, chosen, copies.numpy())
        return RowList(copies, starts)

    def part(self, first: int, last: int) -> RowList:
        """Those of the robots from `first` to before `last`, not copied."""
        starts = self.starts[first : last + 1]
        return RowList(self.rows[starts[0] - self.starts[0] : starts[-1] - self.starts[0]], starts)

    @staticmethod
    def join(lists: Sequence[RowList]) -> RowList:
        """One list, of the robots of the first list, then of the second, and so on."""
        counts = np.concatenate([np.diff(each.starts) for each in lists])
        return RowList(torch.cat([each.rows for each in lists]), np.append(0, np.cumsum(counts)))


class Inputs(NamedTuple):
    """What an encoder reads of R observations, scaled: `own` (R, O), and sets of rows."""

    own: torch.Tensor
    sets: tuple[RowList, ...] = ()

    def take(self, chosen: np.ndarray) -> Inputs:
        """Those of the chosen observations, copied."""
        return Inputs(
            self.own.index_select(0, torch.from_numpy(chosen)), tuple(part.take(chosen) for part in self.sets)
        )

    def part(self, first: int, last: int) -> Inputs:
        """Those of the observations from `first` to before `last`, not copied."""
        return Inputs(self.own[first:last], tuple(part.part(first, last) for part in self.sets))

    @staticmethod
    def join(parts: Sequence[Inputs]) -> Inputs:
        """Those of the first part, then of the second, and so on, copied."""
        own, sets = zip(*parts, strict=True)
        return Inputs(torch.cat(own), tuple(RowList.join(lists) for lists in zip(*sets, strict=True)))


class Encoder(nn.Module):
    """Base of the encoders of flat observations (R, D + extra). The extra columns belong to the own row.

    Encoders of one kind and size read the same `Inputs`, whatever their weights.
    """

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

    @abstractmethod
    def prepare(self, flat: torch.Tensor) -> Inputs:
        """What it reads of flat observations (R, D + extra): all that does not depend on the weights."""

    @abstractmethod
    def run(self, inputs: Inputs) -> tuple[torch.Tensor, Any]:
        """Features (R, features_dim), of which the first `given` are inputs, and what `gradients` needs."""

    @abstractmethod
    def gradients(self, kept: Any, gradient: torch.Tensor) -> list[torch.Tensor]:
        """Gradients of `parameters`, in order, from that of the features after the first `given`."""

    def forward(self, flat: torch.Tensor) -> torch.Tensor:
        """Features (R, features_dim) of flat observations (R, D + extra)."""
        return _Features.apply(self, flat, *self.parameters())


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
        self.features_dim, self.given = self.own_size + width + spots, self.own_size

    def prepare(self, flat: torch.Tensor) -> Inputs:
        """The own row, and the used rows of neighbours and range points."""
        first, last = OWN + self.max_neighbors * ROW, flat.shape[1] - self.extra
        emphasised = emphasis(flat[:, LAMBDA2 : LAMBDA2 + 1])
        own = torch.cat([flat[:, :OWN] / self.scales[:OWN], emphasised, flat[:, last:]], dim=1)
        divisors, sets = self.scales.numpy(), []
        for begin, end, size in ((OWN, first, ROW), (first, last, POINT)):
            slots = np.ascontiguousarray(flat.numpy()[:, begin:end]).reshape(len(flat), -1, size)
            starts = np.empty(len(flat) + 1, np.int64)
            count_used(slots, starts)
            rows = flat.new_empty(int(starts[-1]), size)
            copy_used(slots, divisors[begin : begin + size], rows.numpy())
            sets.append(RowList(rows, starts))
        return Inputs(own, tuple(sets))

    def run(self, inputs: Inputs) -> tuple[torch.Tensor, Any]:
        """The own row and the sums of its sets."""
        own, (neighbors, points) = inputs
        start = torch.addmm(self.row.bias, own, self.own.weight.T)
        same = self.point.bias.expand(len(own), -1).contiguous()
        terms, kept_terms = add_set(neighbors, start, self.row, self.term)
        spots, kept_spots = add_set(points, same, self.point, self.spot)
        return torch.cat([own, terms, spots], dim=1), (own, kept_terms, kept_spots)

    def gradients(self, kept: Any, gradient: torch.Tensor) -> list[torch.Tensor]:
        """Of row, own, term, point and spot."""
        own, kept_terms, kept_spots = kept
        width = self.term.out_features
        start, row, *term = set_gradients(kept_terms, gradient[:, :width], self.term)
        same, point, *spot = set_gradients(kept_spots, gradient[:, width:], self.spot)
        return [row, start.sum(0), (own.T @ start).T, *term, point, same.sum(0), *spot]


class FlatEncoder(Encoder):
    """The scaled observation, for a plain multi-layer perceptron to compare with."""

    def __init__(self, observation_space: spaces.Box, max_neighbors: int = 8, extra: int = 0) -> None:
        super().__init__(observation_space, max_neighbors, extra)
        self.features_dim = self.given = observation_space.shape[0] + EMPHASIS

    def prepare(self, flat: torch.Tensor) -> Inputs:
        """All columns, then the emphasis."""
        return Inputs(torch.cat([flat / self.scales, emphasis(flat[:, LAMBDA2 : LAMBDA2 + 1])], dim=1))

    def run(self, inputs: Inputs) -> tuple[torch.Tensor, Any]:
        """They are the inputs."""
        return inputs.own, None

    def gradients(self, kept: Any, gradient: torch.Tensor) -> list[torch.Tensor]:
        """It has no parameters."""
        return []


class _Features(torch.autograd.Function):
    """An encoder's features, for autograd."""

    @staticmethod
    def forward(ctx, encoder, flat, *parameters):
        features, ctx.kept = encoder.run(encoder.prepare(flat))
        ctx.encoder = encoder
        return features

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient):
        return None, None, *ctx.encoder.gradients(ctx.kept, gradient[:, ctx.encoder.given :])


def add_set(rows: RowList, start: torch.Tensor, first: nn.Linear, second: nn.Linear) -> tuple[torch.Tensor, Any]:
    """SHARE sum_k silu(second(silu(first row_k + start_r))) over the rows k of each robot r, (R, W), and what it kept.

    The bias of `first` is part of start (R, W). Written out, with its gradient, because autograd passes over the memory
    three times as often.
    """
    one = rows.rows @ first.weight.T
    inner, total = torch.empty_like(one), torch.empty_like(start)
    activate_with(one.numpy(), rows.starts, start.numpy(), inner.numpy())
    two = torch.addmm(second.bias, inner, second.weight.T)
    add_up(two.numpy(), rows.starts, total.numpy())
    return total, (rows, one, inner, two)


def set_gradients(kept: Any, gradient: torch.Tensor, second: nn.Linear) -> list[torch.Tensor]:
    """Gradients of start, of the weight of `first`, and of weight and bias of `second`."""
    rows, one, inner, two = kept
    gradient = gradient.contiguous()
    start = torch.empty_like(gradient)
    spread_gradient(gradient.numpy(), rows.starts, two.numpy())
    before = two @ second.weight
    collect_gradient(before.numpy(), rows.starts, one.numpy(), start.numpy())
    return [start, (rows.rows.T @ before).T, (inner.T @ two).T, two.sum(0)]


ENCODERS: dict[str, type[Encoder]] = {"set": SetEncoder, "mlp": FlatEncoder}
