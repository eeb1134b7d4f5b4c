"""Distributions of microfacet normals, a file each, and their masking where that is a formula."""
