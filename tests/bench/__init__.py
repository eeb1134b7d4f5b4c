"""Benchmarks: `python -m tests.bench [SECTION ...]` writes results/bench/; one file a section."""
