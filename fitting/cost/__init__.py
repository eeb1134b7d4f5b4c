"""What accuracy costs in time, and fits that are asked for an accuracy or a time (docs/cost.md)."""
