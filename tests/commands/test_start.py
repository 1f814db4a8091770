"""Which cores a plain start takes, and what it does where ranks cannot be started."""

import math

import pytest

from tests.support.small_scenes import MIXED, write
from vgmpi.commands import cli, plan_command, rank_supervisor, start
from vgmpi.commands.flags import parse_arguments
from vgmpi.commands.start import choose_ranks, expected_particles, predicted_run_seconds
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.parallel.launch import describe_stop, launched_by
from vgmpi.planning.cost.run_estimate import predicted_seconds
from vgmpi.planning.cost.throughput import ASSUMED_THROUGHPUT
from vgmpi.runtime import process_limits
from vgmpi.scene.loader import load
from vgmpi.solver.initial_particles import plan_for, prepare

LONG = ("time.end=60",)


@pytest.fixture
def path(tmp_path):
    return write(tmp_path, MIXED.replace("PRECISION", "single"))


@pytest.fixture
def free(monkeypatch):
    """A machine of four cores that nobody uses; a list with the number that is free."""
    cores = [4.0]
    for name in ("OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK", "SLURM_JOB_ID", "SLURM_NTASKS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(start, "physical_cores", lambda: 4)
    monkeypatch.setattr(start.FreeCores, "measure", lambda self: cores[0])
    return cores


@pytest.fixture
def asked(monkeypatch):
    """What is run, without running it: words of ranks, and of this process."""
    calls = []
    monkeypatch.setattr(rank_supervisor, "find_mpirun", lambda: "mpirun")
    monkeypatch.setattr(
        rank_supervisor, "run_on_ranks", lambda mpirun, n, words: calls.append(n) or 0
    )
    monkeypatch.setattr(cli, "main", lambda words: calls.append(words) or 0)
    return calls


def test_ranks_are_as_many_as_the_time_pays_for(path):
    assert choose_ranks(load(path), 4).ranks == 1
    assert "too small" in choose_ranks(load(path), 4).reason
    assert choose_ranks(load(path, LONG), 4) == (4, "")
    assert choose_ranks(load(path, LONG), 1) == (1, "")
    assert choose_ranks(load(path, LONG), 4, stop_steps=20).ranks == 1
    assert choose_ranks(load(path, LONG), 4, stop_seconds=2.0).ranks == 1


def test_the_time_is_near_that_of_the_plan(path):
    """Its particles are counted by points in shapes; the plan makes them, and knows what touches
    what and how full blocks are. In this scene of tiny bodies
    that is three quarters of the time."""
    scene = load(path, LONG)
    plan = plan_for(scene, prepare(scene, SerialCommunicator(), None))
    whole = predicted_seconds(scene, plan, 1, ASSUMED_THROUGHPUT["single"])
    count = sum(expected_particles(scene, obj) for obj in scene.object)
    assert math.isclose(count, plan.particles, rel_tol=0.05)
    assert 0.2 * whole < predicted_run_seconds(scene, 1) < 1.1 * whole


def test_a_long_run_takes_all_cores(path, free, asked, capsys):
    words = [str(path), "--set", LONG[0]]
    assert cli.run(words) == 0
    assert asked == [4]
    assert "4 of 4 cores: 4 ranks" in capsys.readouterr().err


def test_other_programs_keep_their_cores(path, free, asked, capsys):
    words = [str(path), "--set", LONG[0]]
    free[0] = 1.9
    cli.run(words)
    free[0] = 0.6
    cli.run(words)
    assert asked == [2, words]
    said = capsys.readouterr().err
    assert "2 of 4 cores: 2 ranks; other programs use the rest (--ranks 4 takes them" in said
    assert "1 of 4 cores: other programs use the rest" in said


@pytest.mark.parametrize(
    "words, count, reason",
    [
        (["--set", LONG[0]], 4, "4 of 4 cores, which a run takes by itself if they are free"),
        ([], 1, "1 of 4 cores: the scene is too small for more"),
        (["--set", LONG[0], "--ranks", "3"], 3, ""),
        (["--set", LONG[0], "--threads", "2"], 1, ""),
        (["--set", LONG[0], "--engine", "numpy"], 1, ""),
    ],
)
def test_a_plan_is_for_the_ranks_of_a_plain_run(path, free, monkeypatch, words, count, reason):
    monkeypatch.setattr(plan_command, "physical_cores", lambda: 4)
    monkeypatch.setattr(plan_command, "find_mpirun", lambda: "mpirun")
    args = parse_arguments([str(path), "--plan", *words])
    scene = load(args.scene, args.set)
    assert plan_command.planned_ranks(scene, args, SerialCommunicator()) == (count, reason)
    monkeypatch.setattr(plan_command, "find_mpirun", lambda: None)
    without = plan_command.planned_ranks(scene, args, SerialCommunicator())
    if count == 4:
        assert without == (1, "there is no mpirun here: a run takes 4 threads")
    else:
        assert without == (count, reason)


def test_the_time_of_a_plan_is_that_on_its_ranks(path, free, monkeypatch, capsys):
    pace = ASSUMED_THROUGHPUT["single"]._replace(origin="as told")
    monkeypatch.setattr(plan_command.calibration, "host_throughput", lambda *_, **__: pace)
    monkeypatch.setattr(plan_command, "default_pilot_run", lambda *_: None)
    monkeypatch.setattr(plan_command, "physical_cores", lambda: 4)
    monkeypatch.setattr(plan_command, "find_mpirun", lambda: "mpirun")
    times = []
    for words in ([], ["--ranks", "1"]):
        assert cli.main([str(path), "--plan", "--set", "time.end=600", *words]) == 0
        out = capsys.readouterr().out
        times.append(out.split("  time ")[1].split("\n")[0])
    assert "on 4 rank(s)" in times[0] and "on 1 rank(s)" in times[1]
    assert times[0].split(" on ")[0] != times[1].split(" on ")[0]


@pytest.mark.parametrize(
    "words", [["--ranks", "1"], ["--threads", "2"], ["--engine", "numpy"], ["--check"], ["--plan"]]
)
def test_what_starts_no_ranks(words, path, free, asked):
    words = [str(path), "--set", LONG[0], *words]
    cli.run(words)
    assert asked == [words]


def test_ranks_of_a_launcher_start_none(path, free, asked, monkeypatch):
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    words = [str(path), "--set", LONG[0]]
    cli.run(words)
    assert asked == [words]
    assert launched_by({"PMI_RANK": "0"}) == "mpirun" and launched_by({"SLURM_NTASKS": "1"})
    assert launched_by({"OMPI_ALLOW_RUN_AS_ROOT": "1"}) == ""


def test_without_mpirun_there_are_threads(path, free, asked, monkeypatch, capsys):
    monkeypatch.setattr(rank_supervisor, "find_mpirun", lambda: None)
    words = [str(path), "--set", LONG[0]]
    cli.run(words)
    assert asked == [[*words, "--threads", "4"]]
    assert "4 of 4 cores: 4 threads, since there is no mpirun here" in capsys.readouterr().err
    assert cli.run([*words, "--ranks", "2"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--ranks 2: there is no mpirun" in line


def test_a_scene_with_errors_is_told_once(path, free, capsys):
    assert cli.run([str(path), "--set", "domain.cell=-1"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "domain.cell" in line


def test_other_ranks_than_the_flag_says(path, capsys):
    assert cli.main([str(path), "--ranks", "3"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("--ranks 3: this program was started on 1 rank(s)")


def script(tmp_path, text):
    file = tmp_path / "mpirun"
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)
    return str(file)


def test_an_mpirun_that_fails(path, tmp_path):
    mpirun = script(tmp_path, 'echo "no slots are left" >&2; exit 1')
    with pytest.raises(rank_supervisor.LaunchError, match="starts no ranks: no slots are left"):
        rank_supervisor.run_on_ranks(mpirun, 2, [str(path)])
    with pytest.raises(rank_supervisor.LaunchError, match="none: No such file"):
        rank_supervisor.run_on_ranks(str(tmp_path / "none"), 2, [str(path)])


def test_an_mpirun_of_another_mpi(path, tmp_path):
    """Each of its ranks sees itself alone; the run must not be made twice."""
    text = '[ "$1" = --version ] && exit\nshift 2\n"$@" & "$@" & wait'
    with pytest.raises(rank_supervisor.LaunchError, match="every rank is alone"):
        rank_supervisor.run_on_ranks(script(tmp_path, text), 2, [str(path)])
    assert not (path.parent / "out").exists()


def test_a_quota_counts_as_fewer_cores(monkeypatch, tmp_path):
    (tmp_path / "own").write_text("0::/box/inner\n")
    group = tmp_path / "groups" / "box"
    (group / "inner").mkdir(parents=True)
    (group / "cpu.max").write_text("150000 100000\n")
    (group / "inner" / "cpu.max").write_text("max 100000\n")
    monkeypatch.setattr(process_limits, "_OWN", tmp_path / "own")
    monkeypatch.setattr(process_limits, "_CGROUPS", tmp_path / "groups")
    monkeypatch.setattr(process_limits, "_allowed", lambda: list(range(8)))
    monkeypatch.setattr(process_limits, "_TOPOLOGY", str(tmp_path / "{}"))
    assert process_limits.physical_cores() == 2
    (group / "cpu.max").write_text("max 100000\n")
    assert process_limits.physical_cores() == 8
    for number in range(8):
        (tmp_path / str(number)).write_text(f"{number % 4},{number % 4 + 4}\n")
    assert process_limits.physical_cores() == 4


def test_free_cores_are_measured():
    assert 0.0 <= process_limits.FreeCores().measure() <= process_limits.available_cores() + 0.5


def test_the_line_of_supervised_ranks():
    line = "to stop with a checkpoint: Ctrl-C, or kill 7"
    assert describe_stop("Open MPI v4.1.4", 71, None, "7") == line
