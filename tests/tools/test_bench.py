"""The benchmark: all compute the same, a wrong one is named, times add up, results keep."""

import importlib.util
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks import compare_checkouts
from vgmpi.materials import registry
from vgmpi.tools.bench import __main__, interleaved_rounds, roofline
from vgmpi.tools.bench import __main__ as command
from vgmpi.tools.bench.benchmark_case import BenchError, Case, WorkerError, lay_out
from vgmpi.tools.bench.interleaved_rounds import Contestant, Worker, run_interleaved

OWN, PLAIN = Contestant("own"), Contestant("plain")
NEEDS = {"taichi_rival": "taichi", "warp_rival": "warp"}
ALL = [OWN, PLAIN, Contestant("taichi_rival"), Contestant("warp_rival")]


@pytest.fixture(scope="module", params=["fluid", "elastic"])
def rows(request, tmp_path_factory):
    """Rows by label of a contest of all contestants that are installed."""
    folder = tmp_path_factory.mktemp("b")
    there = [c for c in ALL if c.module not in NEEDS or importlib.util.find_spec(NEEDS[c.module])]
    if shutil.which("mpirun"):
        there.append(Contestant("own", ranks=2))
    case = Case(request.param, 500)
    lay_out(case, ["single"], folder)
    found = run_interleaved(case, there, 2, 0.01, folder, lambda line: None)
    return {c.label: row for c, row in zip(there, found, strict=True)}


@pytest.mark.parametrize("label", [c.label for c in ALL])
def test_a_contestant_computes_what_ours_does(rows, label):
    if label not in rows:
        pytest.skip("not installed: pip install 'vgmpi[bench]'")
    row = rows[label]
    assert "note" not in row and "wrong" not in row, row
    assert row["checked"]["steps"] == 30
    assert len(row["rounds"]) == 2 and all(r["seconds"] > 0 for r in row["rounds"])


@pytest.mark.mpi
def test_two_ranks_compute_the_same_bits(rows):
    label = Contestant("own", ranks=2).label
    if label not in rows:
        pytest.skip("no mpirun")
    assert rows[label]["checked"]["far"] == 0 and rows[label]["checked"]["fast"] == 0
    assert "wrong" not in rows[label]


class Here:
    """A worker in this process."""

    def __init__(self, contestant, case, folder, **changed):
        module = importlib.import_module(contestant.path)
        numbers = case.numbers()
        numbers["constants"] |= changed.pop("constants", {})
        given = {
            "ranks": 1,
            "threads": contestant.threads,
            "folder": folder / contestant.precision,
            "particles": folder / "dense.npz",
            "numbers": {**numbers, **changed},
        }
        self.contestant, self.doing = contestant, module.Contestant(given)
        self.closed = False

    def ask(self, do, **what):
        return getattr(self.doing, do)(**what)

    def close(self):
        self.closed = True


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder, case = tmp_path_factory.mktemp("s"), Case("elastic", 500)
    lay_out(case, ["single", "double"], folder)
    return case, folder


def check(small, **changed):
    """The row of the numba loops with other numbers than ours."""
    case, folder = small
    row = {}
    live = [({}, Here(OWN, case, folder)), (row, Here(PLAIN, case, folder, **changed))]
    interleaved_rounds._check(case, live, folder)
    return row


def test_the_same_numbers_agree(small):
    assert "wrong" not in check(small)


def test_both_precisions_and_threads_agree(small):
    live = [({}, Here(c, *small)) for c in (OWN, Contestant("own", "double"))]
    live += [({}, Here(Contestant("own", threads=2), *small))]
    interleaved_rounds._check(small[0], live, small[1])
    assert not any("wrong" in row for row, _ in live)
    assert 0 < live[1][0]["checked"]["far"] < 1e-6
    assert live[2][0]["checked"]["far"] == 0


@pytest.mark.parametrize(
    "changed, named",
    [
        ({"constants": {"mu": 0.0, "lam": 0.0}}, "fast"),
        ({"constants": {"mu": 3.8e5}}, "fast"),  # 1 % off
        ({"gravity": 0.0}, "momentum"),
        ({"density": 1099.0}, "mass"),
        ({"dt": 0.0}, "far"),
    ],
)
def test_a_contestant_that_computes_something_else_is_named(small, changed, named):
    assert f"{named} " in check(small, **changed)["wrong"]


def test_a_contestant_that_fails_leaves_the_others_alone(small):
    case, folder = small

    class Ends(Here):
        def ask(self, do, **what):
            raise BenchError("ended early")

    good, bad = {}, {}
    broken = Ends(PLAIN, case, folder)
    live = [(bad, broken), (good, Here(PLAIN, case, folder))]
    for row, _ in live:
        row["module"] = "plain"
    interleaved_rounds._turns(case, live, 2, 0.001, lambda line: None)
    assert bad["note"] == "ended early" and "rounds" not in bad and broken.closed
    assert len(good["rounds"]) == 2


def test_a_rival_begins_again_before_the_border(small):
    """The dense grid has no walls: particles that left it would write beyond its memory."""
    case, folder = small
    rival = Here(PLAIN, case, folder).doing
    room = rival.numbers["steps"]
    assert rival.round(2 * room + 1)["steps"] == 2 * room + 1
    rival.restart()
    for _ in range(room):
        rival.step()
    x = rival.state()[0] / rival.numbers["dx"]
    assert 1.5 < x.min() and x.max() < rival.numbers["cells"] - 2.5
    assert x.max() > rival.numbers["cells"] - 8


def test_stage_times_add_up_to_the_whole(small):
    ours = Here(OWN, *small).doing
    found = ours.round(2)
    assert set(found["stages"]) >= {"p2g", "grid", "g2p", "sort"}
    assert sum(found["stages"].values()) == pytest.approx(found["seconds"], rel=0.02)
    assert ours.simulation.sorts == 4  # at the start, after the first cycle, after two more
    assert found["steps"] < 60


def test_particles_that_would_be_prepared_anew_are_refused(tmp_path):
    """They would be at rest."""
    case = Case("fluid", 500)
    lay_out(case, ["single"], tmp_path)
    scene = tmp_path / "single" / "scene.toml"
    scene.write_text(scene.read_text().replace("frames = 2", "frames = 3"))
    with pytest.raises(BenchError, match="measure again"):
        Here(OWN, case, tmp_path)


def test_a_round_begins_anew_before_the_cube_reaches_a_wall(small):
    ours = Here(OWN, *small).doing
    ours.simulation.step = 600
    ours.round(1)
    assert ours.simulation.step < 100


# ---- materials ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", registry)
def test_every_material_has_a_row(kind):
    """Where this fails, give the new material the least it needs in KEYS of
    tools/bench/benchmark_case.py."""
    case = Case(kind, 500)
    assert (
        case.dt > 0 and roofline.operation_count(case.material)["flops"] > roofline.TRANSFER_FLOPS
    )


def test_a_program_that_fails_is_no_error_of_the_words(small, tmp_path, monkeypatch, capsys):
    """A measurement with a row that failed ends with 1, as does a command whose worker fails."""
    monkeypatch.setattr(interleaved_rounds.sys, "executable", shutil.which("false"))
    case, folder = small
    rows = run_interleaved(case, [PLAIN], 1, 0.01, folder, lambda line: None)
    assert rows[0]["note"].startswith("ended early")
    group = {"law": "fluid", "particles": case.particles, "rows": rows}
    assert __main__.failures({"groups": [group]}) == [
        f"fluid, {__main__._label(rows[0])}: {rows[0]['note']}"
    ]

    def fail(args):
        raise WorkerError("ended early")

    monkeypatch.setitem(command.COMMANDS, "speed", (*command.COMMANDS["speed"][:2], fail))
    assert command.main(["--particles", "500"]) == 1
    assert capsys.readouterr().err == "vgmpi bench: ended early\n"


def test_words_and_flops_of_a_fluid():
    assert roofline.operation_count(Case("fluid", 500).material)["words"] == 34 + 3
    assert roofline.operation_count(Case("elastic", 500).material)["words"] == 34 + 27
    tally = [0]
    number = roofline._Counted(tally)
    law = registry["fluid"](kind="fluid").law()
    registry["fluid"].advance(law, (number,), (number,) * 9, number)
    # 2 for the trace, 10 for that of the square, 5 to join them with dt, one sum, one minimum
    assert tally == [19]


def test_the_floor_is_the_slower_of_memory_and_arithmetic():
    machine = {"copy": {"1": 10.0}, "triad": {"1": 20.0}, "fma": {"single": 100.0, "double": 50.0}}
    assert roofline.minimum_time(machine, {"words": 50, "flops": 10}, "single") == 50 * 4 / 20
    assert roofline.minimum_time(machine, {"words": 50, "flops": 4000}, "double") == 4000 / 50
    machine["copy"]["2"], machine["triad"]["2"] = 30.0, 25.0
    assert roofline.minimum_time(machine, {"words": 60, "flops": 10}, "single", 2) == 60 * 4 / 30
    assert roofline.minimum_time(machine, {"words": 60, "flops": 4000}, "single", 2) == 4000 / 200


def test_the_machine_is_measured():
    found = roofline.measure_roofline(length=1 << 22, repeats=3)
    assert found["copy"]["1"] > 0.1 and found["triad"]["1"] > 0.1
    assert found["fma"]["single"] > found["fma"]["double"] > 0.1


# ---- results ------------------------------------------------------------------------------------


def row(module, seconds, **more):
    made = Contestant(module, **more)
    turns = [
        {"steps": 10, "seconds": s, "wall": 2 * s, "stages": {"p2g": s} if module == "own" else {}}
        for s in seconds
    ]
    return {**vars(made), "name": made.name, "on": made.on, "clock": made.clock, "rounds": turns}


def results(scale=1.0):
    rows = [
        row("own", [scale, 2 * scale, scale]),
        row("own", [1.0, 4.0, 0.25], ranks=2),
        row("plain", [4.0, 2.0, 8.0]),
        {**row("warp_rival", []), "note": "not installed"},
    ]
    group = {"law": "fluid", "particles": 1000, "rounds": 3, "words": 37, "flops": 900}
    return {
        "when": "2026-01-01 00:00:00",
        "machine": {"name": "Abacus", "cores": 2, "caches": "L1 48K"},
        "versions": {"vgmpi": "0", "commit": "abc"},
        "roof": {},
        "groups": [{**group, "rows": rows}],
    }


def test_speeds_are_medians_of_neighbouring_rounds():
    group = results()["groups"][0]
    assert __main__.speed(group, group["rows"][0]) == 1
    # of wall time: 2/2, 4/8, 2/.5
    assert __main__.speed(group, group["rows"][1]) == 1
    # of processor time: 1/1, 2/6, 1/4; the ratio of the medians is 1/4
    group["rows"][2] = row("plain", [1.0, 6.0, 4.0])
    assert __main__.speed(group, group["rows"][2]) == pytest.approx(1 / 3)
    assert __main__.speed(group, group["rows"][3]) is None


def test_the_table_says_what_is_missing_and_what_is_wrong():
    found = results()
    found["groups"][0]["rows"][2]["wrong"] = "computes something else"
    said = __main__.text(found)
    assert "Warp single 1 core" in said and "not installed" in said
    assert "computes something else" in said and "kept the cores busy (2.00" in said
    assert __main__.failures(found) == ["fluid, numba loops single 1 core: computes something else"]


def test_results_keep_and_compare(tmp_path, capsys):
    before, after = tmp_path / "a.json", tmp_path / "b.json"
    before.write_text(json.dumps(results()))
    after.write_text(json.dumps(results(scale=0.5)))
    assert __main__.text(json.loads(before.read_text())) == __main__.text(results())
    for words in (["compare", str(before), str(after)], ["--compare", str(before), str(after)]):
        assert command.main(words) == 0
        said = capsys.readouterr().out
        line = next(line for line in said.splitlines() if "vgmpi single 1 core" in line)
        assert line.split()[4:] == ["100000.0", "50000.0", "0.500", "0.500", "0.500"]
        assert "careful" not in said


def test_other_machines_are_said_and_the_pace_is_divided_out():
    a, b = results(), results()
    b["machine"] = {**b["machine"], "name": "Slide rule"}
    for turn in b["groups"][0]["rows"][2]["rounds"]:
        turn["seconds"] *= 2
    said = __main__.compare(a, b)
    assert "careful" in said and "Slide rule" in said
    line = next(line for line in said.splitlines() if "vgmpi single 1 core" in line)
    assert line.split()[-1] == "0.500"


def test_a_file_of_something_else_is_one_clear_line(tmp_path, capsys):
    path = tmp_path / "x.json"
    path.write_text("[]")
    assert command.main(["compare", str(path), str(path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_rows_can_be_chosen():
    def labels(*words):
        given = command.arguments([*words])
        return [c.label for c in command.contestants("fluid", given)]

    assert len(labels()) == 10
    assert labels("--only", "warp") == ["vgmpi single 1 core", "Warp single 1 core"]
    assert labels("--precision", "double", "--only", "nothing") == ["vgmpi double 1 core"]
    assert "vgmpi single 1 core avx2" in labels("--cpu", "avx2")
    given = command.arguments([])
    assert not any("Taichi" in c.label for c in command.contestants("sand", given))


# ---- workers ------------------------------------------------------------------------------------


def worker_that_says(*answers):
    worker = Worker.__new__(Worker)
    worker.links = [(None, io.StringIO(json.dumps(a) + "\n")) for a in answers]
    return worker


def test_a_tool_that_is_not_installed_is_named():
    with pytest.raises(BenchError, match=r"pip install 'vgmpi\[bench\]'"):
        worker_that_says({"error": "no module", "missing": "taichi"})._hear()
    with pytest.raises(BenchError, match="no luck"):
        worker_that_says({"error": "no luck", "missing": None})._hear()


def test_ranks_answer_as_one(monkeypatch):
    answers = [
        {"seconds": 1.0, "wall": 3.0, "stages": {"p2g": 1.0}},
        {"seconds": 2.0, "wall": 1.0, "stages": {"p2g": 2.0}},
    ]
    worker = worker_that_says(*answers)
    monkeypatch.setattr(worker, "_hear", lambda: answers)
    found = worker.ask("round", units=1)
    assert found == {"seconds": 2.0, "wall": 3.0, "stages": {"p2g": 1.5}}


def test_a_worker_that_dies_is_said(small, monkeypatch):
    case, folder = small
    monkeypatch.setattr(interleaved_rounds.sys, "executable", shutil.which("false"))
    with pytest.raises(BenchError, match="ended early"):
        Worker(PLAIN, case, folder)
    assert not (folder / "socket").exists()


def test_particles_are_jittered_in_their_cells_and_move_as_said(small):
    case, folder = small
    with np.load(folder / "dense.npz") as found:
        x, v = found["x"], found["v"]
    assert len(x) == 512 == case.particles
    per_step = np.abs(v).max() * case.dt / 0.01
    assert 0.045 < per_step <= 0.05 + 1e-12
    cells = np.unique(np.floor(x / 0.01), axis=0, return_counts=True)
    assert len(cells[1]) == 64 and (cells[1] == 8).all()
    assert np.unique(np.round(x / 0.01 % 0.5, 3)).size > 100


def test_another_checkout_is_the_one_that_runs(tmp_path, monkeypatch):
    """Not this one twice: what lies in the other's folder counts."""
    monkeypatch.setattr(compare_checkouts, "ROUND", 0.01)
    here = Path(compare_checkouts.__file__).parents[2]
    found = compare_checkouts.measure("fluid", 500, here, 2, lambda line: None)
    assert found.shape == (2, 3) and (found > 0).all()
    (tmp_path / "vgmpi").mkdir()
    (tmp_path / "vgmpi/__init__.py").write_text("raise ImportError('of another checkout')\n")
    with pytest.raises(BenchError, match="of another checkout"):
        compare_checkouts.measure("fluid", 500, tmp_path, 1, lambda line: None)
