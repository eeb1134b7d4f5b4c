"""``python -m merlfit``."""

from merlfit.fitting.cli import main

main()
