"""Many trainings of one algorithm: several seeds, or a sweep over settings, here or by Ray Tune."""
