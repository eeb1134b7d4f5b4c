"""Assessing a fit: errors, pictures, choice between models, status, what the data determine."""
