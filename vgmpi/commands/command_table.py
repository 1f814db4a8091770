"""The command `vgmpi`: a table of subcommands.

The module of a subcommand is imported when the subcommand is called.
"""

import contextlib
import importlib
import os
import platform
import sys
from typing import NamedTuple

from vgmpi.runtime.command_line import EXIT_USAGE
from vgmpi.runtime.message_text import did_you_mean
from vgmpi.runtime.process_limits import find_unusable_limit
from vgmpi.runtime.versions import program_version


class Command(NamedTuple):
    """A subcommand: the module whose function runs it, and one line of help."""

    module: str
    summary: str
    flags: tuple[str, ...] = ()  # words that come before the user's
    function: str = "main"


COMMANDS = {
    "run": Command(
        "vgmpi.commands.cli", "run a scene; `vgmpi scene.toml` does the same", function="run"
    ),
    "check": Command("vgmpi.commands.cli", "check a scene file and write nothing", ("--check",)),
    "plan": Command("vgmpi.commands.cli", "estimate memory and time of a scene", ("--plan",)),
    "prepare": Command(
        "vgmpi.commands.cli", "generate the particles of a scene and stop", ("--prepare",)
    ),
    "inspect": Command("vgmpi.commands.cli", "describe an output file or an input", ("--inspect",)),
    "render": Command(
        "vgmpi.postprocess.commands.render", "draw a video of a run", function="command"
    ),
    "view": Command("vgmpi.postprocess.commands.view", "draw particles colored by any field"),
    "live": Command("vgmpi.postprocess.commands.live", "show a run in a browser while it goes on"),
    "export": Command(
        "vgmpi.postprocess.commands.export", "write frames as Gaussian files or meshes"
    ),
    "fit": Command("vgmpi.tools.fit.__main__", "identify a scene's parameters from data"),
    "tradeoff": Command(
        "vgmpi.tools.tradeoff.setting_study", "compare accuracy and time by settings"
    ),
    "energy": Command("vgmpi.tools.tradeoff.energy_drift", "measure energy over many steps"),
    "photo": Command("vgmpi.tools.photo.__main__", "make a scene from photographs"),
    "convert": Command(
        "vgmpi.tools.convert.__main__", "convert a PhysGaussian or VersaGauss scene"
    ),
    "bench": Command("vgmpi.tools.bench.__main__", "measure the speed of this machine"),
}
HELP = """usage: vgmpi scene.toml [flags]
       vgmpi COMMAND [flags]
       vgmpi --version

Multiphase physics on 3D Gaussians. `vgmpi COMMAND --help` lists the flags of a command.

commands:
{commands}

exit codes: 0 done, 1 unexpected error, 2 wrong scene or flags, 3 the simulation blew up,
75 stopped with a checkpoint, 130 interrupted"""


def format_help() -> str:
    """Return the help of `vgmpi`: all subcommands with a line each."""
    lines = (f"  {name:10s}{command.summary}" for name, command in COMMANDS.items())
    return HELP.format(commands="\n".join(lines))


def main(argv: list[str]) -> int:
    """Run a subcommand, or the scene that is named first.

    Args:
        argv: Words of the command line without the program's name.

    Returns:
        The exit code.
    """
    if argv and argv[0] in ("-h", "--help"):
        print(format_help())
        return 0
    if argv and argv[0] == "--version":
        print(f"vgmpi {program_version()}, Python {platform.python_version()}")
        return 0
    if problem := _suggest_command(argv) or find_unusable_limit():
        print(f"vgmpi: {problem}", file=sys.stderr)
        return EXIT_USAGE
    name, words = (argv[0], argv[1:]) if argv and argv[0] in COMMANDS else ("run", argv)
    command = COMMANDS[name]
    with _signals_held(name):
        try:
            module = importlib.import_module(command.module)
        except ModuleNotFoundError as error:
            if error.name and error.name.startswith("vgmpi"):
                raise
            print(f"vgmpi {name}: the package {error.name} is not installed", file=sys.stderr)
            return EXIT_USAGE
        flags = () if {"-h", "--help"} & set(words) else command.flags
        return getattr(module, command.function)([*flags, *words])


def _signals_held(name: str) -> contextlib.AbstractContextManager[None]:
    """Return what holds the signal that stops a run until the run takes it; of others nothing."""
    if name != "run":
        return contextlib.nullcontext()
    from vgmpi.solver.stop_requests import stop_signal_held  # not for --help of the others

    return stop_signal_held()


def _suggest_command(argv: list[str]) -> str:
    """Return one line if the first word is like a command and names no scene, else ""."""
    word = argv[0] if argv else ""
    if word in COMMANDS or not word.isidentifier() or os.path.lexists(word):
        return ""
    suggestion = did_you_mean(word, COMMANDS)
    return f"there is no command or scene {word!r}{suggestion}" if suggestion else ""
