"""What policies are worth on one scenario, measure by measure: the card of its page, and what the terminal shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fovconn_env.training.evaluation.comparison import Table, percent
from fovconn_env.training.evaluation.statistics import Estimate

# what it is called, the measures of `summary` it shows, and how
ROWS = (
    ("never disconnected, %", ("never_disconnected",), "share"),
    ("success, %", ("success",), "share"),
    ("collision, %", ("collision",), "share"),
    ("time connected", ("connected_share",), ".2%"),
    ("lambda2, least (mean over episodes)", ("min_lambda2",), ".3f"),
    ("lambda2, mean (clipped at lambda2_max)", ("mean_lambda2",), ".3f"),
    ("leader's progress (achieved / pushed)", ("progress",), ".3f"),
    ("duration, s", ("duration",), ".1f"),
    ("links lost per minute", ("links_lost_per_minute",), ".1f"),
    ("pairs in mutual / one-way view", ("mutual_share", "one_way_share"), ".0%"),
    ("least separation, m (worst episode)", ("least_separation",), ".2f"),
    ("lambda2_hat relative error, p50 / p95", ("lambda2_error_median", "lambda2_error_p95"), ".2%"),
    ("sin(yaw error / 2), rms, mutual / one-way", ("yaw_rms_mutual", "yaw_rms_one_way"), ".4f"),
    ("yaw valid, share of mutual / one-way time", ("yaw_valid_mutual", "yaw_valid_one_way"), ".1%"),
    ("bytes sent per robot and second", ("bytes_per_second",), ",.0f"),
)


def card(summaries: dict[str, dict[str, Any]]) -> Table:
    """Head and rows of a table with one column for each summary, under its name; shares with their 95 % intervals."""
    rows = [[title, *(_shown(report, names, form) for report in summaries.values())] for title, names, form in ROWS]
    return ["measure", *summaries], rows


def _shown(report: dict[str, Any], names: Sequence[str], form: str) -> str:
    if form == "share":
        (name,) = names
        return percent(Estimate(report[name], *report[f"{name}_interval"]))
    return " / ".join("-" if report[name] != report[name] else format(report[name], form) for name in names)
