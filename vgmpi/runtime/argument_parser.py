"""Parser of flags whose errors are one line, with the flag or word that was probably meant."""

import argparse
import re
import sys
from typing import NoReturn

from .suggestions import did_you_mean

EXIT_USAGE = 2
_CHOICE = re.compile(r"invalid choice: '?(.*?)'? \(choose from (.*)\)", re.DOTALL)


class ArgumentParser(argparse.ArgumentParser):
    """argparse.ArgumentParser with errors of one line in place of the usage."""

    def error(self, message: str) -> NoReturn:
        """Print what is wrong in one line and end the program with code 2."""
        hint = self._hint(message)
        line = " ".join(message.split())
        sys.stderr.write(f"{self.prog}: {line}{hint}; {self.prog} --help lists the flags\n")
        raise SystemExit(EXIT_USAGE)

    def _hint(self, message: str) -> str:
        """Return a suggestion for the first word that a message complains of, or ""."""
        choice = _CHOICE.search(message)
        if choice is not None:
            return did_you_mean(choice[1], re.findall(r"[\w.-]+", choice[2]))
        _, _, words = message.partition("unrecognized arguments: ")
        first = words.split("=")[0].split()[:1]
        if first and first[0].startswith("-"):
            return did_you_mean(first[0], self._option_string_actions)
        return ""
