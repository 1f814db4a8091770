"""Reference page docs/reference/commands.md, generated from the argparse parsers.

`python -m vgmpi.commands.command_reference` prints it.
"""

import argparse
import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from . import command_table

INTRODUCTION = """\
# Commands

<!-- made by: python -m vgmpi.commands.command_reference > docs/reference/commands.md -->

This page lists every command of vgmpi with its flags. `vgmpi COMMAND --help` prints the same.

```bash
vgmpi scene.toml                          # run a scene on one rank
mpirun -n 2 python -m vgmpi scene.toml    # run a scene on two ranks
vgmpi COMMAND [flags]                     # any other command
```

`python -m vgmpi` and `vgmpi` are the same program.

| command | purpose |
|---|---|
"""
EXIT_CODES = """\
## Exit codes

| code | meaning |
|---|---|
| 0 | The command finished. |
| 1 | Unexpected error, or a file that cannot be read or written. |
| 2 | Error in the scene, in another input file or in the flags. |
| 3 | The simulation blew up. All earlier output is complete. |
| 75 | The run stopped with a checkpoint. |
| 130 | The command was interrupted. |

[Stop and resume](../how-to/stop-and-resume.md) lists the signals.
"""


class _ParserFound(Exception):
    """Carries the parser that a command was about to use."""

    def __init__(self, parser: argparse.ArgumentParser):
        super().__init__(parser.prog)
        self.parser = parser


@contextmanager
def _parsers_are_raised() -> Iterator[None]:
    """Make every `parse_args` raise its parser instead of reading the command line."""
    original = argparse.ArgumentParser.parse_args

    def raise_parser(self, *_args, **_kwargs):
        """Raise the parser instead of parsing."""
        raise _ParserFound(self)

    argparse.ArgumentParser.parse_args = raise_parser  # type: ignore[method-assign]
    try:
        yield
    finally:
        argparse.ArgumentParser.parse_args = original  # type: ignore[method-assign]


def command_parser(name: str) -> argparse.ArgumentParser:
    """Return the parser of a command of `vgmpi`."""
    command = command_table.COMMANDS[name]
    function = getattr(importlib.import_module(command.module), command.function)
    while hasattr(function, "__wrapped__"):  # decorators turn exceptions into exit codes
        function = function.__wrapped__
    words = ["--help"] if name == "bench" else []
    with _parsers_are_raised():
        try:
            function(words)
        except _ParserFound as found:
            return found.parser
    raise ValueError(f"{name}: uses no parser")


def page() -> str:
    """Return the text of docs/reference/commands.md."""
    rows = (
        f"| [`vgmpi {name}`](#vgmpi-{name}) | {command.summary} |"
        for name, command in command_table.COMMANDS.items()
    )
    parts = [INTRODUCTION + "\n".join(rows) + "\n"]
    for name, command in command_table.COMMANDS.items():
        parts.append(f"## vgmpi {name}\n\n{_sentence(command.summary)}\n")
        if command.flags:
            parts.append(
                f"Same as `vgmpi run {' '.join(command.flags)}`, with the flags of "
                "[`vgmpi run`](#vgmpi-run).\n"
            )
            continue
        parts.extend(_command(f"vgmpi {name}", command_parser(name)))
    return "\n".join([*parts, EXIT_CODES])


def _command(title: str, parser: argparse.ArgumentParser) -> Iterator[str]:
    """Yield usage and arguments of a parser, and of its subcommands."""
    subcommands = {}
    arguments = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            subcommands = action.choices
        elif not isinstance(action, argparse._HelpAction) and action.help != argparse.SUPPRESS:
            arguments.append(action)
    if subcommands:
        names = ", ".join(f"`{name}`" for name in subcommands)
        yield f"The first word chooses one of {names}.\n"
    else:
        positional = [_positional(a) for a in arguments if not a.option_strings]
        words = " ".join([title, *positional, "[flags]"])
        yield f"```bash\n{words}\n```\n"
    if arguments:
        rows = ["| argument | default | meaning |", "|---|---|---|", *map(_row, arguments)]
        yield "\n".join(rows) + "\n"
    for name, subparser in subcommands.items():
        yield f"### {title} {name}\n\n{_sentence(subparser.description or '')}\n"
        yield from _command(f"{title} {name}", subparser)


def _row(action: argparse.Action) -> str:
    """Return the row of an argument."""
    name = ", ".join(_option(action, word) for word in action.option_strings)
    cells = (f"`{name or _positional(action)}`", _default(action), _help(action))
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _option(action: argparse.Action, word: str) -> str:
    """Return an option with its value, such as `--threads N`."""
    if action.nargs == 0:
        return word
    value = _value(action)
    return f"{word} {f'[{value}]' if action.nargs == '?' else value}"


def _positional(action: argparse.Action) -> str:
    """Return a positional argument, in brackets if it may be left out."""
    value = _value(action, upper=False)
    return f"[{value}]" if action.nargs in ("?", "*") else value


def _value(action: argparse.Action, upper: bool = True) -> str:
    """Return the name of an argument's value."""
    if action.metavar:
        return action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar)
    if action.choices:
        return "{" + ",".join(map(str, action.choices)) + "}"
    return action.dest.upper() if upper else action.dest


def _default(action: argparse.Action) -> str:
    """Return the default of an argument, or nothing if it is no value."""
    value = action.default
    if action.nargs == 0 or value in (None, "", [], argparse.SUPPRESS):
        return ""
    words = " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
    return f"`{words}`"


def _help(action: argparse.Action) -> str:
    """Return the text of an argument on one line, without a default that has its own column."""
    text = " ".join((action.help or "").replace("%%", "%").split())
    default = _default(action).strip("`")
    return text.removesuffix(f" [{default}]").removesuffix(f"; default: {default}")


def _sentence(text: str) -> str:
    """Return a text as a sentence on one line."""
    text = " ".join(text.split())
    return text[:1].upper() + text[1:].rstrip(".") + "." if text else ""


if __name__ == "__main__":
    sys.stdout.write(page())
