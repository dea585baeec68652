"""Trainers: behaviour cloning, DAgger, PPO and residual PPO, and data sets of flights."""
