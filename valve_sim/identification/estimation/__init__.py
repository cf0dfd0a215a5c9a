"""Parameters from data: noise, output-error fits, intervals."""
