"""The page of commands is that of the parsers."""

from pathlib import Path

import pytest

from vgmpi.commands import command_reference, command_table

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "commands.md"


def test_page_is_up_to_date():
    assert PAGE.read_text() == command_reference.page(), "run `make docs`"


@pytest.mark.parametrize("name", command_table.COMMANDS)
def test_every_command_has_a_section(name):
    assert f"## vgmpi {name}\n" in PAGE.read_text()
