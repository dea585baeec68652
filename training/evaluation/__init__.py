"""Many flights and what they say: `evaluate` flies a policy on a scenario from many seeds, `summary` sums it up."""

from fovconn_env.training.evaluation.flights import Evaluation, evaluate, summary

__all__ = ["Evaluation", "evaluate", "summary"]
