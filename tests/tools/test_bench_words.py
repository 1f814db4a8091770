"""Wrong words of `vgmpi bench`: one line before anything is measured."""

from typing import Annotated, ClassVar, Literal

import pytest

from vgmpi.materials import registry
from vgmpi.runtime.config.schema import Quantity, StrictModel
from vgmpi.tools.bench import __main__ as command


class Jelly(StrictModel):
    kind: Literal["jelly"]
    density: Annotated[float, Quantity("kg/m3", gt=0)] = 1000.0
    wobble: Annotated[float, Quantity("Pa", gt=0)]
    Law: ClassVar = tuple


def test_a_material_without_defaults_is_one_clear_line(monkeypatch, capsys):
    monkeypatch.setitem(registry, "jelly", Jelly)
    assert command.main(["--laws", "jelly", "--only", "vgmpi"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and "needs wobble" in said[0] and "KEYS" in said[0]


def test_an_unknown_material_is_one_clear_line(capsys):
    assert command.main(["--laws", "custard"]) == 2
    assert capsys.readouterr().err == (
        f"vgmpi bench: there is no material of kind 'custard'; known: {', '.join(registry)}\n"
    )


@pytest.mark.parametrize(
    "words",
    [
        ["--json", "none/found.json"],
        ["--json", "."],
        ["board", "-o", "file"],
        ["--particles", "0"],
        ["--seconds", "nan"],
        ["card", "--rounds", "0"],
        ["compare", "file", "file"],
    ],
)
def test_wrong_words_are_one_line_before_anything_is_measured(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("text")
    monkeypatch.setattr(command, "measure", lambda *_: pytest.fail("measured"))
    try:
        code = command.main(words)
    except SystemExit as end:
        code = end.code
    assert code == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
