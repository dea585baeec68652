"""How many inputs the fuzz tests try: a few in `make test`, as many as are promised in `make fuzz`."""

from __future__ import annotations

import os

FULL = os.environ.get("FUZZ") == "full"


def count(few: int, full: int) -> int:
    """A number of inputs: `few` in `make test`, `full` in `make fuzz`, which runs what is marked `fuzz`."""
    return full if FULL else few
