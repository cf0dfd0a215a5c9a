"""Parameters from data: noise and errors of recordings, priors, output-error fits, evidence, intervals."""
