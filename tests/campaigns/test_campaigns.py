"""Every campaign at a small size; `make campaigns` runs them whole."""

from types import SimpleNamespace

import pytest

from tests.campaigns import __main__ as command
from tests.campaigns.result import Result


def _each():
    for name, one in command.campaigns().items():
        marks = [getattr(pytest.mark, mark) for mark in getattr(one, "MARKS", ())]
        yield pytest.param(one, marks=marks, id=name)


@pytest.mark.parametrize("one", list(_each()))
def test_a_small_campaign(one, tmp_path):
    result = one.campaign(one.SMALL, 0, tmp_path)
    assert result.failures == [] and result.tried == one.SMALL <= one.COUNT


def test_a_failed_case_is_told_and_ends_in_code_1(tmp_path, monkeypatch, capsys):
    def campaign(count, seed, folder):
        (folder / "case").write_text(f"{count} {seed}")
        return Result(count, {"held": count - 1}, [f"broken: {folder / 'case'}"])

    one = SimpleNamespace(NAME="made", COUNT=9, campaign=campaign)
    monkeypatch.setattr(command, "campaigns", lambda: {"made": one})
    assert command.main(["--seed", "3", "--keep", str(tmp_path)]) == 1
    said, kept = capsys.readouterr().out, tmp_path / "made" / "case"
    assert "9 tried: 8 held; 1 failed" in said and f"broken: {kept}" in said
    assert kept.read_text() == "9 3"
    one.campaign = lambda *_: pytest.skip("no such thing here")
    assert command.main(["made", "--keep", str(tmp_path)]) == 0
    assert "left out: no such thing here" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        command.main(["other"])
    assert "there is no campaign other; there are made" in capsys.readouterr().err
