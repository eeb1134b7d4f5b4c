"""INFERENCE: from a file to a fitted material with error bars."""
