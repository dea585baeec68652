"""ROS 2: what is known of a flight as messages, their definitions, and where they go: MCAP files, Foxglove."""
