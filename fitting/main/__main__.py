"""``python -m merlfit``."""

from .fitting.cli import main  # pyright: ignore[reportMissingImports] - installed, this file lies beside fitting/

main()
