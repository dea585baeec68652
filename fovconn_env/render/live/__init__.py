"""The live picture of `render()` and `fovconn play`, on pygame surfaces."""
