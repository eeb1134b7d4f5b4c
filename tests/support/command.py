"""The command line in this process."""

from merlfit.fitting.commands import cli
from typer.testing import CliRunner


def call(*words):
    """What `merlfit WORDS` prints, and its exit code."""
    return CliRunner().invoke(cli.app, [str(word) for word in words])
