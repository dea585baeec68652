"""What the JSON object of a record must be, whoever wrote it; see `record.to_json`. Raises `SettingError`."""

from __future__ import annotations

from typing import Any

from fovconn_env.errors import rule
from fovconn_env.fields import check_keys, check_texts, check_whole

_HEAD = ("format", "study", "fovconn_env", "run", "seeds", "units", "policies", "results")
_ROW = ("policy", "scenario", "settings", "count", "measures")
_MOST, _HUGE = 2**63, 1e300


def check_record(data: Any, format: int) -> None:
    """All of a record; format: the one that this version reads."""
    rule(isinstance(data, dict), "a record", "a JSON object", type(data).__name__, "is it another file?")
    given = data.get("format")
    same = type(given) is int and given == format
    rule(same, "a record", f"of the format {format}", given, "fly the study again")
    check_keys("a record", data, _HEAD, ("overall", "scenarios"))
    check_texts("study and version", [data["study"], data["fovconn_env"]])
    for name in ("run", "units", "policies"):
        _check_object(name, data[name])
    _check_object("scenarios", data.get("scenarios", {}))
    _check_list("seeds", data["seeds"])
    for seed in data["seeds"]:
        check_whole("seeds", seed, 0, _MOST, "of an episode")
    for policy, about in data["policies"].items():
        check_texts("policies", [policy])
        _check_object(f"policies {policy!r}", about)
    for name in ("results", "overall"):
        _check_list(name, data.get(name, []))
        for k, row in enumerate(data.get(name, ())):
            _check_row(f"{name}[{k}]", row)


def _check_row(name: str, row: Any) -> None:
    check_keys(name, row, _ROW, ("against", "episodes", "histograms"))
    check_texts(f"{name}.policy and scenario", [row["policy"], row["scenario"]])
    _check_object(f"{name}.settings", row["settings"])
    check_whole(f"{name}.count", row["count"], 0, _MOST, "episodes")
    _check_measures(f"{name}.measures", row["measures"])
    _check_object(f"{name}.against", row.get("against", {}))
    for other, measures in row.get("against", {}).items():
        _check_measures(f"{name}.against {other!r}", measures)
    for key in ("episodes", "histograms"):
        _check_object(f"{name}.{key}", row.get(key, {}))
        for measure, values in row.get(key, {}).items():
            check_texts(f"{name}.{key}", [measure])
            _check_list(f"{name}.{key} {measure!r}", values)
            _check_numbers(f"{name}.{key} {measure!r}", values)


def _check_measures(name: str, measures: Any) -> None:
    _check_object(name, measures)
    for measure, value in measures.items():
        check_texts(name, [measure])
        parts = value if isinstance(value, list) else [value, None, None]
        rule(len(parts) == 3, f"{name} {measure!r}", "a number, or [value, low, high]", value, "null is NaN")
        _check_numbers(f"{name} {measure!r}", parts)


def _check_numbers(name: str, values: list[Any]) -> None:
    odd = [type(value).__name__ for value in values if value is not None and not _is_number(value)]
    rule(not odd, name, f"null or numbers below {_HUGE:g}", odd[:1], "null is NaN")


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) < _HUGE


def _check_object(name: str, value: Any) -> None:
    rule(isinstance(value, dict), name, "an object", type(value).__name__, "with names and values")


def _check_list(name: str, value: Any) -> None:
    rule(isinstance(value, list), name, "a list", type(value).__name__, "of one each")
