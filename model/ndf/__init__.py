"""Distributions of microfacet normals, a file each."""
