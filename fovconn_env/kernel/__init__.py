"""The compiled core: plain numbers in, plain numbers out. `step` advances the worlds."""
