"""What flies a whole team by the truth: ceilings to compare policies with."""
