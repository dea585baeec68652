"""What defines an environment: settings, presets, levels and hard tasks, the leader, and scenarios as JSON."""

from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.presets import HARD, LEVELS, PRESETS
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.serialize import scenario_from_json, scenario_to_json

__all__ = ["HARD", "LEVELS", "PRESETS", "Recorded", "Scenario", "scenario_from_json", "scenario_to_json"]
