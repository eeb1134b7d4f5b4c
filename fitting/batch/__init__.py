"""Fits of many files: in this process, in worker processes, or on a cluster."""
