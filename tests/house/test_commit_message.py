"""The hook that checks commit messages, and what installs it."""

import os
import shutil
import subprocess

import pytest

from tests.house.source_file import ROOT

GOOD = "solver: slip in one class\n\nEach lookup was written twice.\n\nBits: same.\n"
NAMES = {
    f"GIT_{who}_{what}": "x@y" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")
}
SCISSORS = f"# {24 * '-'} >8 {24 * '-'}"  # above the diff of git commit -v
ENVIRONMENT = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
ENVIRONMENT |= NAMES | {"GIT_CONFIG_GLOBAL": "/dev/null", "GIT_CONFIG_NOSYSTEM": "1"}


def call(folder, *words):
    """Run a command in a folder with a git that has no settings; return code and text."""
    job = subprocess.run(words, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
    return job.returncode, job.stdout + job.stderr


def git(folder, *words):
    code, text = call(folder, "git", *words)
    assert code == 0, text
    return text


def commit(folder, message, *flags):
    """Return the code and the text of a commit with a message."""
    words = ("git", "-c", "core.editor=true", "commit", "--allow-empty", "-m", message, *flags)
    return call(folder, *words)


@pytest.fixture
def bare(tmp_path):
    """A repository with the folder of hooks, which are not installed."""
    git(tmp_path, "init", "-q", "-b", "main")
    shutil.copytree(ROOT / ".githooks", tmp_path / ".githooks")
    return tmp_path


@pytest.fixture
def repository(bare):
    assert call(bare, ".githooks/install.sh") == (0, "")
    assert commit(bare, GOOD)[0] == 0
    return bare


@pytest.mark.parametrize(
    "message",
    [
        GOOD,
        f"{'tests: ':a<72}\n\nWhy.\n\nBits: same.",
        "apps/fit, tests/house: two areas\n\nBits: same.\n\nThe body may follow.",
        GOOD + "\nCo-authored-by: A <a@b>\n",
        "# a comment\n\n" + GOOD,
        f"{GOOD}{SCISSORS}\ndiff",
        "fixup! solver: slip in one class",
        "squash! solver: slip in one class",
        "Merge branch 'other'",
        'Revert "solver: slip in one class"',
    ],
)
def test_a_good_message_passes(repository, message):
    code, text = commit(repository, message, "--cleanup=verbatim")
    assert code == 0, text


@pytest.mark.parametrize(
    "message, error",
    [
        (GOOD.replace("solver: s", "S"), 'subject is "Slip in one class"; allowed is "area: what'),
        (GOOD.replace("solver:", "Solver:"), 'subject is "Solver: slip in one class"'),
        (GOOD.replace("solver: ", "solver:"), 'subject is "solver:slip in one class"'),
        (f"{'tests: ':a<73}\n\nWhy.\n\nBits: same.", "subject has 73 characters; allowed are 72"),
        (GOOD.replace("\n\nEach", "\nEach"), 'line 2 is "Each lookup was written twice."'),
        ("solver: slip in one class", "there is no body"),
        ("solver: slip\n\nBits: same.\n\nCo-authored-by: A <a@b>", "there is no body"),
        (GOOD.replace("Bits: same.", ""), 'there is no line "Bits: ..."'),
        (GOOD.replace("Bits: same.", "Bits:"), 'there is no line "Bits: ..."'),
        (GOOD.replace("Bits: same.", "All bits: same."), 'there is no line "Bits: ..."'),
        (GOOD.replace("Bits", f"{SCISSORS}\nBits"), 'there is no line "Bits: ..."'),
        (GOOD.replace("Bits: same.", "# Bits: same."), 'there is no line "Bits: ..."'),
    ],
)
def test_a_bad_message_is_one_line(repository, message, error):
    code, text = commit(repository, message, "--cleanup=verbatim")
    assert code == 1 and text.startswith(f"commit message: {error}") and text.count("\n") == 1
    assert git(repository, "log", "--format=%s") == "solver: slip in one class\n"


def test_merges_and_reverts_pass_with_any_message(repository):
    git(repository, "switch", "-q", "-c", "other")
    (repository / "a.txt").touch()
    git(repository, "add", "a.txt")
    assert commit(repository, GOOD)[0] == 0
    git(repository, "switch", "-q", "main")
    git(repository, "merge", "-q", "--no-ff", "-m", "of another form", "other")
    git(repository, "revert", "--no-edit", "HEAD^2")
    git(repository, "revert", "--no-commit", "HEAD")
    assert commit(repository, "of another form")[0] == 0
    assert commit(repository, "of another form")[0] == 1


def test_a_work_tree_has_the_rule_if_it_has_the_folder(repository):
    git(repository, "worktree", "add", "-q", "tree")
    assert commit(repository / "tree", "of another form")[0] == 0
    shutil.copytree(ROOT / ".githooks", repository / "tree/.githooks")
    assert commit(repository / "tree", "of another form")[0] == 1
    assert commit(repository / "tree", GOOD)[0] == 0


def test_a_hook_is_installed_once(repository):
    hook = repository / ".git/hooks/commit-msg"
    before = hook.read_text()
    assert call(repository, ".githooks/install.sh") == (0, "")
    assert hook.read_text() == before


def test_another_hook_stays(bare):
    hook = bare / ".git/hooks/commit-msg"
    hook.write_text("#!/bin/sh\n")
    code, text = call(bare, ".githooks/install.sh")
    assert code == 0 and "commit-msg is another hook" in text and text.count("\n") == 1
    assert hook.read_text() == "#!/bin/sh\n"
    hook.unlink()
    hook.symlink_to("absent")
    assert "is another hook" in call(bare, ".githooks/install.sh")[1] and not hook.exists()


def test_another_folder_of_hooks_stays(bare):
    git(bare, "config", "core.hooksPath", "mine")
    code, text = call(bare, ".githooks/install.sh")
    assert code == 0 and "core.hooksPath is mine" in text and text.count("\n") == 1
    assert git(bare, "config", "core.hooksPath") == "mine\n" and not (bare / "mine").exists()


def test_outside_of_a_checkout_nothing_is_installed(tmp_path):
    """In an unpacked archive, also one within the repository of somebody else."""
    shutil.copytree(ROOT / ".githooks", tmp_path / "archive/.githooks")
    assert call(tmp_path, "archive/.githooks/install.sh") == (0, "")
    git(tmp_path, "init", "-q")
    assert call(tmp_path, "archive/.githooks/install.sh") == (0, "")
    assert not (tmp_path / ".git/hooks/commit-msg").exists()


def test_the_set_up_of_developers_installs_it():
    lines = (ROOT / "setup.sh").read_text().splitlines()
    assert (
        len([line for line in lines if "*,dev,*" in line and ".githooks/install.sh" in line]) == 1
    )
