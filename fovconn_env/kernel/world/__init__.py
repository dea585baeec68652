"""Nature and the referee: dynamics, sensors, radio, faults, the operator, how an episode ends."""
