"""Compile ahead what a flight needs, for an image of a container for example: `python -m fovconn_env.baselines`."""

from __future__ import annotations

import argparse

from fovconn_env import scenario
from fovconn_env.baselines.registry import ORACLES, POLICIES, find_pilot
from fovconn_env.flights.metrics import compile_ahead


def main() -> None:
    """Compile, or find compiled, what the named policies need."""
    parser = argparse.ArgumentParser(prog="python -m fovconn_env.baselines", description=__doc__)
    parser.add_argument("policy", nargs="*", default=["expert"], metavar="POLICY", help="by default expert")
    given = parser.parse_args()
    for name in given.policy:
        if name not in (*POLICIES, *ORACLES):
            parser.error(f"POLICY must be one of {', '.join([*POLICIES, *ORACLES])}, got {name!r}")
        compile_ahead(find_pilot(name), scenario())


if __name__ == "__main__":
    main()
