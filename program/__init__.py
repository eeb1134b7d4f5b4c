"""Fit the two-scale reflection + diffraction model to measured BRDFs."""
