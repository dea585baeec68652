"""What environments say of themselves when they are printed."""

from __future__ import annotations

from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.version import __version__


def describe(*scenarios: Scenario, **sizes: int) -> str:
    """Scenario, team, sizes and version: "Mix-v0, n_agents=6, num_envs=2, fovconn_env 0.2.0".

    Of several scenarios all names and all team sizes: "Mix-v0/ScaleUp-v0, n_agents=6/12, ...".
    """
    names, teams = (
        [*dict.fromkeys(parts)] for parts in zip(*((s.name, str(s.n_agents)) for s in scenarios), strict=True)
    )
    words = ["/".join(names), f"n_agents={'/'.join(teams)}", *(f"{name}={value}" for name, value in sizes.items())]
    return ", ".join([*words, f"fovconn_env {__version__}"])
