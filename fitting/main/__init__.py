"""Fit the two-scale reflection + diffraction model to measured BRDFs; installed as the package ``merlfit`` itself."""
