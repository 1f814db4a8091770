"""Reference page docs/reference/file-format.md, generated from the tables in file_layout.py.

`python -m vgmpi.io.layout_reference` prints it.
"""

from itertools import groupby

from . import file_layout

INTRODUCTION = f"""\
# Output files

This page lists the files of a run and all their datasets.

`python -m vgmpi.io.layout_reference` writes this page from `vgmpi/io/file_layout.py`.

    out/
      gaussians.h5                    a row per particle, written once at the start
      frames/frame_00000.vtkhdf ...   a file per frame; pyvista.read() gives PolyData
      series.vtkhdf                   all frames as one time series, for ParaView
      ledger.csv                      conservation log: a row per frame and phase
      probe_NAME.csv                  a row per sample of a [[probe]]
      checkpoints/                    the last two checkpoints
      blowup/frames/                  the state in which a run blew up

All numbers are in SI units. Positions are domain coordinates: the box starts at (0, 0, 0) and z
points up. The `transform` of an object maps back to the coordinates of its file. n is the number of
particles, f4 and f8 are single and double precision, i4 and i8 are integers. HDF5 files are
contiguous, uncompressed and readable with any HDF5 since 1.8 (series.vtkhdf: 1.10). With
`output.compression = "gzip"`, the arrays of frames are in chunks with the filters shuffle and gzip
of HDF5. Files are written atomically: as `NAME.tmp`, flushed to disk, then renamed. The bytes of
every file are the same for any number of ranks.

Every file contains checksums (those of a checkpoint are in its manifest). Readers compare them and
name the damaged file and dataset or line. A file of another schema than {file_layout.SCHEMA} is
refused. So is a file that is a link, or that stores its numbers in another file, except
series.vtkhdf, which refers to the frames of its folder.
`vgmpi inspect FILE` verifies a whole file.
"""
ABOUT_CHECKPOINTS = f"""\
`checkpoint_000000000.json`, the manifest, is written last: size of the file, and for every dataset
its shape, type and a CRC32 (zlib) for each {file_layout.CRC_ROWS} rows. A checkpoint without a
manifest, or one that differs from it or from its name, is skipped. The last two are kept. A resume
also checks every row against the scene (finite numbers, positions in the domain, particles of the
group, each exactly once). An inconsistent checkpoint ends it with one line and exit code 2.
"""
ABOUT_TABLES = """\
One row per frame and phase, numbers with all digits. Readers name the line of a modified row. A
resume refuses a table with a modified row or without its last rows, because the checkpoint stores
the `crc` of the last row before it. An incomplete last line, left by a killed run, is ignored.
`crc` is `zlib.crc32(words, before)`: words are the bytes of the line before its last comma, before
is the crc of the line above, or 0 in the first line.
"""


def _below(folder, datasets):
    """Return datasets with the folder of a file in front of their names."""
    return [d._replace(name=folder + d.name) for d in datasets]


def _frame_datasets():
    """Return the datasets of a frame with their full names."""
    places = {"positions": "VTKHDF/Points"}
    return [
        *(
            d._replace(name=places.get(d.name, f"VTKHDF/PointData/{d.name}"))
            for d in file_layout.FRAME
        ),
        *_below("VTKHDF/FieldData/", file_layout.FRAME_FIELD_DATA),
        *_below("VTKHDF/", file_layout.FRAME_TOPOLOGY),
        *file_layout.FRAME_OWN,
    ]


def _table(datasets):
    """Return a Markdown table of datasets."""
    lines = ["| name | shape | type | unit | meaning |", "|---|---|---|---|---|"]
    for d in datasets:
        kind = d.dtype.replace("|", " or ")
        words = (f"`{d.name}`", d.shape, kind, d.unit, d.meaning)
        lines.append("| " + " | ".join(w.replace("|", "\\|") for w in words) + " |")
    return "\n".join(lines) + "\n"


def _columns(columns, skip_count=0):
    """Return a Markdown table of columns of a CSV file, a row for those of the same meaning."""
    lines = ["| column | type | unit | meaning |", "|---|---|---|---|"]
    for cells, group in groupby(columns[skip_count:], lambda d: (d.dtype, d.unit, d.meaning)):
        names = ", ".join(f"`{d.name}`" for d in group)
        lines.append(f"| {names} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _probe_section(kind: str) -> str:
    """Return the columns of a probe behind those of the longest table that they begin with."""
    tables, columns = file_layout.PROBE_COLUMNS, file_layout.PROBE_COLUMNS[kind]
    begins = {other: t for other, t in tables.items() if other != kind and columns[: len(t)] == t}
    base = max(begins, key=lambda other: len(begins[other]), default="")
    skip_count = len(begins.get(base, file_layout.SAMPLE_COLUMNS))
    text = f"The columns of `{base}`, then:\n\n" if base else ""
    return f"### {kind}\n\n{text}{_columns(columns, skip_count)}"


ABOUT_ENERGY = (
    "Gravity, walls, colliders, loads, inlets and outlets change momentum and energy. With "
    "`domain.gravity_ramp_time`, the potential energy refers to gravity at its full strength; with "
    "`domain.gravity_keyframes`, to gravity at that time.\n"
)


def _ledger_section() -> list[str]:
    """Return the parts of the page on ledger.csv."""
    return [
        "## ledger.csv\n",
        ABOUT_TABLES,
        _columns([*file_layout.LEDGER_COLUMNS, file_layout.ROW_CHECKSUM]),
        "Before `crc`, only with `[[inlet]]`, `[[outlet]]` or an open wall; particles_in - "
        "particles_out is `particles`, exactly, and mass_in - mass_out is `mass`, to rounding:\n",
        _columns(file_layout.OPEN_SYSTEM_COLUMNS),
        "Behind these, only if liquids have phases of their own:\n",
        _columns(file_layout.LIQUID_COLUMNS),
        "Behind these, only with free rigid bodies: sums over all of them, in the first row of a "
        "time and 0 in its other rows, so that sums over rows are totals:\n",
        _columns(file_layout.RIGID_COLUMNS),
        ABOUT_ENERGY,
    ]


def page() -> str:
    """Return the text of docs/reference/file-format.md."""
    parts = [
        INTRODUCTION,
        "## frames/frame_00000.vtkhdf\n",
        "VTKHDF 2.0 PolyData, one part, rows in ascending `id`. Frames are identified by their "
        "numbers; missing frames do not change the numbers of the others. `id` and the points are "
        "always present, the other fields as `output.fields` requests. Covariance, opacity and "
        "color are stored in gaussians.h5 only: a renderer finds them by `id` and deforms them "
        "with F or J.\n",
        _table(_frame_datasets()),
        "Attributes: `VTKHDF/Type`, `VTKHDF/Version`, and `/schema` (integer). "
        "`gaussians_crc` is the CRC32 of the checksums in gaussians.h5, those of its texts and "
        "`shade` left out, as JSON pairs in the order of their names; checkpoints have it too.\n",
        "## series.vtkhdf\n",
        "All frames in sequence, as virtual datasets of the same names. The file contains no "
        "numbers itself and finds the frames beside it from any working directory. It is valid "
        "after every frame.\n",
        _table([*_below("VTKHDF/", file_layout.SERIES_STEPS), *file_layout.SERIES_OWN]),
        "## gaussians.h5\n",
        "One row per particle id, including particles that enter later; frames contain the present "
        "ones. Objects are contiguous, in the order of the scene; inlets follow, the particles of "
        "each in the order in which they pass its mouth.\n",
        _table(file_layout.GAUSSIAN),
        "Scenery, rendered but without mass (only if the scene has scenery):\n",
        _table(_below("scenery/", file_layout.SCENERY)),
        "Passive Gaussians without mass (only if an object has `passive_gaussians`). With weights "
        "w, carriers i and their deformation gradients F_i in a frame: x = sum w_i (x_i + F_i (x0 "
        "- x0_i)), F = sum w_i F_i, covariance F cov0 F^T.\n",
        _table(_below("passive/", file_layout.PASSIVE)),
        _table(file_layout.GAUSSIAN_TEXTS),
        "Attributes: `schema` (integer), `digest` (text; identifies the preparation).\n",
        "## checkpoints/checkpoint_000000000.h5\n",
        "The number is the step. A group is one phase of one material: group_000, group_001, ... "
        "Rows are in the order of the last sort, which is part of the state: a resumed run "
        "continues with the same bits on any number of ranks.\n",
        _table([*file_layout.CHECKPOINT, *file_layout.CHECKPOINT_TEXTS]),
        ABOUT_CHECKPOINTS,
        *_ledger_section(),
        "## probe_NAME.csv\n",
        "One row per sampling time, written after the step that reaches it, numbers with all "
        "digits. Every table begins with `time` and `step` and ends with `crc`, as in ledger.csv; "
        "between them are the columns of what is measured:\n",
        *map(_probe_section, file_layout.PROBE_COLUMNS),
    ]
    return "\n".join(parts)


if __name__ == "__main__":
    print(page(), end="")
