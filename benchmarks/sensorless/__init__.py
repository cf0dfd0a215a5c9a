"""A valve seen through its current alone: what can be known of it, and a campaign on an independent plant."""
