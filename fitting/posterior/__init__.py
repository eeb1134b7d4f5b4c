"""The posterior of a fit: likelihood, chain, correction (docs/statistics.md)."""
