"""Files of the version before keys, columns and datasets had their present names (schema 1).

The run was made by commit 36bab4b: water with colors by steps, a ball, a moving collider, an inlet,
an outlet and two probes, 66 steps. Its last checkpoint is left out.
"""

import subprocess
import sys
import tarfile
from pathlib import Path

import numpy as np
import pytest

import vgmpi
from vgmpi.io import csv_log, file_layout
from vgmpi.io.run_reader import RunError, inspect

# Python 3.11.3 and older extract without a filter
DATA_ONLY = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
ARCHIVE = Path(__file__).parent / "data" / "run_of_schema_1.tar.xz"


@pytest.fixture
def folder(tmp_path):
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path, **DATA_ONLY)
    return tmp_path


def test_every_file_is_read_and_has_the_new_names(folder, caplog):
    files = vgmpi.read(folder / "out")
    frame = files.frame(-1)
    assert frame["color_sh"].shape == (151, 3) and frame["poses"].shape == (1, 4, 4)
    paddle = files.objects[2]
    assert paddle["is_moving"] and paddle["row_count"] == 0 and paddle["first_row"] == 147
    assert files.objects[1]["tracks_deformation"] and files.objects[0]["color_group"] == 1
    assert files.scene["accuracy"]["transfer"] == "apic-corrected"
    assert files.scene["inlet"][0]["speed"] == 1.0
    with caplog.at_level("INFO", "vgmpi"):
        rows = csv_log.read_rows(folder / "out" / file_layout.LEDGER)
    assert rows[-1]["particles_in"] == 132 and rows[-1]["kinetic_energy"] > 0
    (line,) = caplog.messages
    assert "'kinetic' is now 'kinetic_energy'" in line and "'count' is now 'particles'" in line
    columns = file_layout.PROBE_COLUMNS
    paddle = csv_log.read_rows(folder / "out" / "probe_paddle.csv", columns["collider"])
    assert np.isfinite([paddle[-1]["angular_impulse_y"], paddle[-1]["cumulative_work"]]).all()
    surface = csv_log.read_rows(folder / "out" / "probe_surface.csv", columns["surface_height"])
    assert surface[0]["surface_height"] == pytest.approx(0.1)  # of the tap
    for path in (p for p in (folder / "out").rglob("*") if p.suffix in (".h5", ".vtkhdf")):
        assert "damaged" not in inspect(path) and "NOT VALID" not in inspect(path)


def test_a_damaged_byte_is_still_found(folder):
    path = folder / "out" / file_layout.LEDGER
    path.write_bytes(path.read_bytes().replace(b"ball", b"bell", 1))
    with pytest.raises(RunError, match="ledger.csv:2: damaged"):
        csv_log.read_rows(path)


def test_it_goes_on_and_tells_the_new_words_once(folder):
    scene, out = folder / "scene.toml", folder / "out"
    before = vgmpi.read(out).frame(2)
    job = subprocess.run(
        [sys.executable, "-m", "vgmpi", str(scene), "--resume", "--set", "time.cfl=0.4"],
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert job.returncode == 0, job.stderr
    told = [line for line in job.stderr.splitlines() if "is the old" in line]
    assert sum("'bulk_modulus' is the old name of material.water.tait_coefficient" in line
               for line in told) == 1  # fmt: skip
    assert sum('transfer = "restored" is the old form of' in line for line in told) == 1
    assert len(told) == len({line.split(": ", 1)[1] for line in told})
    assert job.stderr.count("'tables' is now 'log_checksums'") == 1
    rows = csv_log.read_rows(out / file_layout.LEDGER)
    assert [row["step"] for row in rows if row["phase"] == "ball"] == [0, 33, 66]
    assert (out / file_layout.LEDGER).read_text().startswith("time,step,phase,particles,mass,")
    after = vgmpi.read(out).frame(2)
    # the water's contact acts less far from the ball than in the version that wrote the frame
    assert np.abs(after["positions"] - before["positions"]).max() < 2e-5
