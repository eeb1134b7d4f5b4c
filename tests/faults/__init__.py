"""Faults, tried: what happens to files, folders and processes that merlfit works with; `python -m tests.faults`."""
