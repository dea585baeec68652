"""The last seconds of an episode: the instants that were drawn."""

from __future__ import annotations

import numpy as np

from fovconn_env.render.live.instant import Instant

SPAN = 30.0  # s kept


class History:
    """Columns over time, in buffers of twice the capacity; full buffers are moved to their front half."""

    def __init__(self, n_agents: int, step_time: float) -> None:
        self._capacity, self._key, self._end = round(SPAN / step_time) + 1, -1, 0
        rows = 2 * self._capacity
        self._time = np.zeros(rows)
        self._lambda2, self._edges = np.zeros(rows), np.zeros(rows)
        self._lambda2_hat, self._positions = np.zeros((rows, n_agents)), np.zeros((rows, n_agents, 3))
        self._weights = np.zeros((rows, n_agents, n_agents), np.float32)
        self._columns = (self._time, self._lambda2, self._edges, self._lambda2_hat, self._positions, self._weights)

    def add(self, now: Instant) -> None:
        """Append an instant. Rows of another episode, and rows that are not before `now`, are dropped."""
        if now.key != self._key:
            self._key, self._end = now.key, 0
        while self._end > 0 and self._time[self._end - 1] >= now.time - 1e-9:
            self._end -= 1
        if self._end == 2 * self._capacity:
            for column in self._columns:
                column[: self._capacity] = column[self._capacity :]
            self._end = self._capacity
        values = (
            now.time,
            now.lambda2,
            np.count_nonzero(now.weights) // 2,
            now.lambda2_hat,
            now.poses[:, :3],
            now.weights,
        )
        for column, value in zip(self._columns, values, strict=True):
            column[self._end] = value
        self._end += 1

    def rows_since(self, start: float) -> slice:
        """Rows from time `start` on."""
        return slice(int(np.searchsorted(self._time[: self._end], start - 1e-9)), self._end)

    def curves(self, start: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Time (T,), true lambda2 (T,), number of links (T,) and estimates (T, N) from time `start` on."""
        rows = self.rows_since(start)
        return self._time[rows], self._lambda2[rows], self._edges[rows], self._lambda2_hat[rows]

    def tracks(self, start: float) -> np.ndarray:
        """Positions of the robots from time `start` on, (T, N, 3)."""
        return self._positions[self.rows_since(start)]

    def weights(self, time: float) -> np.ndarray:
        """The weights A_ij at the first instant kept from `time` on, (N, N)."""
        return self._weights[self.rows_since(time).start]
