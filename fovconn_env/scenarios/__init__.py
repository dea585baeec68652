"""What defines an environment: settings, presets and levels, the leader, and scenarios as JSON."""
