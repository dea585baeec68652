"""Compile ahead what a flight needs, for an image of a container for example: `python -m fovconn_env.baselines`."""

from __future__ import annotations

import argparse
import itertools

from fovconn_env import scenario
from fovconn_env.baselines.registry import POLICIES
from fovconn_env.flights.metrics import Meter
from fovconn_env.flights.rollout import rollout


def main() -> None:
    """Compile, or find compiled, what the named policies need."""
    parser = argparse.ArgumentParser(prog="python -m fovconn_env.baselines", description=__doc__)
    parser.add_argument("policy", nargs="*", default=["expert"], metavar="POLICY", help="by default expert")
    given = parser.parse_args()
    for name in given.policy:
        if name not in POLICIES:
            parser.error(f"POLICY must be one of {', '.join(POLICIES)}, got {name!r}")
        for _ in itertools.islice(rollout(POLICIES[name], scenario(), [0], observers=[Meter()]), 2):
            pass  # the reset, and one step


if __name__ == "__main__":
    main()
