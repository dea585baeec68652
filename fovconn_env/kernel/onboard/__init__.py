"""What one robot computes, from its own slices alone. Never imports `kernel.world`."""
