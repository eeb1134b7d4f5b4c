"""The directive ``{command} NAME``: usage and options of a command of merlfit, from the program itself."""

from typing import Any

import typer.main
from docutils import nodes
from merlfit.fitting.commands.cli import app as cli
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


class Command(SphinxDirective):
    """Usage in one line, then a list: names of an option, what it does, its default."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The nodes of one command."""
        name = self.arguments[0]
        command = typer.main.get_command(cli).commands[name]  # pyright: ignore[reportAttributeAccessIssue] - a group
        context = command.make_context(name, [], resilient_parsing=True)
        usage = " ".join(["merlfit", name, *map(_argument, command.params), "[OPTIONS]"])
        usage = " ".join(usage.split())
        options = nodes.definition_list(classes=["options"])
        for param in command.params:
            said = (param.help or "").replace("\\[", "[")
            if param.param_type_name == "option" and (default := _default(param, said)):
                said += f" Default: {default}."
            options += nodes.definition_list_item(
                "",
                nodes.term("", _names(param, context)),
                nodes.definition("", nodes.paragraph("", "", *self.parsed(said))),
            )
        return [nodes.literal_block(usage, usage, language="none"), options]

    def parsed(self, text: str) -> list[nodes.Node]:
        """Inline Markdown."""
        return self.parse_inline(text)[0]


def _argument(param: Any) -> str:  # noqa: ANN401 - typer's parameters have no common public type
    if param.param_type_name != "argument":
        return ""
    return (param.metavar or param.name.upper()) + (" ..." if param.nargs == -1 else "")


def _names(param: Any, context: Any) -> str:  # noqa: ANN401
    if param.param_type_name == "argument":
        return _argument(param)
    names = ", ".join([*param.opts, *param.secondary_opts])
    return names if param.is_flag else f"{names} {param.metavar or param.display_type(context)}"


def _default(param: Any, said: str) -> str:  # noqa: ANN401
    unsaid = param.default is None or param.is_flag or "default:" in said or callable(param.default)
    return "" if unsaid or param.default == () else str(param.default)


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_directive("command", Command)
    return {"parallel_read_safe": True}
