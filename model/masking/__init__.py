"""Masking and shadowing of microfacets, a file each."""
