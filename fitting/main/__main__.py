"""The command ``merlfit``, and ``python -m merlfit``."""

import signal


def main() -> None:
    """Entry point; until the commands hear Ctrl-C, and after they do, it ends the program without a word."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # which raises wherever an import or an exit is
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from .fitting.commands.cli import main as commands  # pyright: ignore[reportMissingImports] - installed, it lies beside

    commands()


if __name__ == "__main__":
    main()
