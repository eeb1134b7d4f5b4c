"""Pictures of a fit: each a function that returns a matplotlib figure, one file a picture."""
