"""Pictures of worlds and flights: live (pygame), figures (matplotlib), pages for other viewers (web, rerun)."""
