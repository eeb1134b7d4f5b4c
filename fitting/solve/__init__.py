"""Minimising it: starting points and Levenberg-Marquardt."""
