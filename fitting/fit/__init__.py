"""Fitting one model to samples: weights, data, normal equations, solver, starts, choice between models, errors."""
