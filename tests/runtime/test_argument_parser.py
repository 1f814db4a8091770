"""Wrong flags and commands are one line with the word that was probably meant."""

import pytest

from vgmpi.commands import command_table, flags


def line_of(call, capsys):
    with pytest.raises(SystemExit) as end:
        call()
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


@pytest.mark.parametrize(
    "words, hint",
    [
        (["--overwrote"], "unrecognized arguments: --overwrote (did you mean '--overwrite'?); "),
        (["--rank=2x"], "--ranks: invalid int value: '2x'; "),
        (["--stop-afer", "9 s"], "--stop-afer 9 s (did you mean '--stop-after'?); vgmpi --help"),
        (["--engine", "cdua"], "(did you mean 'cuda'?); vgmpi --help lists the flags"),
    ],
)
def test_a_flag_that_does_not_exist(words, hint, capsys):
    assert hint in line_of(lambda: flags.parse_arguments(["a.toml", *words]), capsys)


def test_a_flag_of_the_renderer(capsys):
    line = line_of(lambda: command_table.main(["render", "out", "--previw"]), capsys)
    assert line.startswith("vgmpi render: ") and "(did you mean '--preview'?)" in line


def test_a_command_that_does_not_exist(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert command_table.main(["rendr", "out"]) == 2
    said = capsys.readouterr().err
    assert said == "vgmpi: there is no command or scene 'rendr' (did you mean 'render'?)\n"
    (tmp_path / "rendr").write_text("nonsense")
    assert command_table.main(["rendr", "--check"]) == 2
    assert "no command" not in capsys.readouterr().err
