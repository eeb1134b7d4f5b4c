"""Masking and shadowing of microfacets where it is no formula of a line: others are beside their distribution."""
