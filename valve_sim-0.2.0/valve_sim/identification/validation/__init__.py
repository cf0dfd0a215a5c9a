"""A declared valve replayed beside recordings."""
