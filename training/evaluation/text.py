"""How numbers, intervals, settings and tables are written, in the terminal, the report and the docs."""

from __future__ import annotations

import dataclasses
import math
import re
from typing import Any

import numpy as np

from fovconn_env.text import printable
from fovconn_env.training.evaluation.record import Record
from fovconn_env.training.evaluation.statistics import Estimate

Table = tuple[list[str], list[list[str]]]  # head, rows
ORACLE = "†"  # stands behind the name of a policy that is one


def number(value: float, form: str) -> str:
    """A number, "-" for NaN."""
    return "-" if math.isnan(value) else format(value, form)


def figures(value: float) -> str:
    """A number with two figures that count, without exponent; "-" for NaN."""
    return "-" if math.isnan(value) else np.format_float_positional(value, 2, fractional=False, trim="-")


def percent(share: Estimate) -> str:
    """A share in percent, its interval in whole ones, near 0 and 100 in tenths: 97.5 [95, 99], 100 [99.6, 100.0]."""
    form = ".1f" if share.low > 0.99 or 0.0 < share.high < 0.01 else ".0f"
    text = number(100 * share.value, ".0f" if share.value in (0.0, 1.0) else ".1f")
    return text if math.isnan(share.low) else f"{text} [{100 * share.low:{form}}, {100 * share.high:{form}}]"


def estimate(quantity: Estimate, form: str, scale: float = 1.0) -> str:
    """A number with its interval: 0.98 [0.97, 0.99]."""
    value, low, high = (number(scale * part, form) for part in quantity)
    return value if math.isnan(quantity.low) else f"{value} [{low}, {high}]"


def marked(record: Record, policy: str) -> str:
    """A policy's name, with `ORACLE` if a record says that it is one."""
    return f"{policy} {ORACLE}" if record.policies[policy]["oracle"] else policy


def settings_in_words(chosen: Any, usual: Any) -> dict[str, str]:
    """Settings by dotted name in which one group of settings differs from another."""
    result = {}
    for item in dataclasses.fields(chosen):
        value, other = getattr(chosen, item.name), getattr(usual, item.name)
        if value == other or item.name == "name":
            continue
        if dataclasses.is_dataclass(value) and type(value) is type(other):
            result |= {f"{item.name}.{name}": text for name, text in settings_in_words(value, other).items()}
        else:
            result[item.name] = _in_words(value)
    return result


def _in_words(value: Any) -> str:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        inside = ", ".join(f"{name}={text}" for name, text in settings_in_words(value, type(value)()).items())
        return f"{type(value).__name__}({inside})"
    if isinstance(value, tuple):
        return f"({', '.join(map(_in_words, value))})"
    return f"{value:.3g}" if isinstance(value, float) else repr(value)


def markdown(table: Table, *, literal: bool = False) -> str:
    """A table in Markdown. literal: numbers stand on the right, and no letter of a cell has a meaning to Markdown."""
    head, rows = table
    text = [[escape(cell) if literal else cell.replace("|", r"\|") for cell in line] for line in [head, *rows]]
    lines = ["| " + " | ".join(line) + " |" for line in text]
    return "\n".join([lines[0], "|---" + ("|---:" if literal else "|---") * (len(head) - 1) + "|", *lines[1:]])


def escape(text: str) -> str:
    """A line of text that Markdown takes literally."""
    return re.sub(r"([\\|<>*_`]|(?<=\])\()", r"\\\1", printable(text))
