"""Results as JSON, text, pages and figures: the only room that formats."""
