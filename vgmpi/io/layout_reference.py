"""Reference page docs/reference/file-format.md, generated from the tables in file_layout.py.

`python -m vgmpi.io.layout_reference` prints it.
"""

from . import file_layout

INTRODUCTION = """\
# Files of a run

`python -m vgmpi.io.layout_reference` writes this page; edit that or `vgmpi/io/file_layout.py`.

    out/
      gaussians.h5                    a row per particle, written once at the start
      frames/frame_00000.vtkhdf ...   a file per frame; pyvista.read() gives PolyData
      series.vtkhdf                   all frames as one time series, for ParaView
      ledger.csv                      a row per frame and phase: mass, momentum, energy
      probe_NAME.csv                  a row per due time of a [[probe]]
      checkpoints/                    the last two states to go on from
      blowup/frames/                  the state in which a run blew up, if one did

All numbers are SI. Positions are domain coordinates: the box starts at (0, 0, 0) and z is up; the
way back to the coordinates an object came in is its `transform`. n is the number of particles, f4
and f8 are single and double precision, i4 and i8 whole numbers. HDF5 files are plain: contiguous,
uncompressed, readable with any HDF5 since 1.8 (series.vtkhdf: 1.10). A file has its final name only
when it is complete: it is written as `NAME.tmp`, brought to the disk, then renamed. The bytes of
every file are the same for any number of ranks.

What is read is what was written: every file holds checksums (a checkpoint's are in its manifest),
and whoever reads compares them and names the file, and the dataset or line, that is damaged. Files
are plain: one that is a link, or that has its numbers in another file, is refused, but for
series.vtkhdf, which is put together of the frames of its folder. `--inspect FILE` verifies a whole
file.
"""
ABOUT_CHECKPOINTS = f"""\
`checkpoint_000000000.json`, the manifest, is written last: size of the file, and for every dataset
its shape, type and a CRC32 (zlib) for each {file_layout.CRC_ROWS} rows. A checkpoint without a
manifest, or one that differs from it or from its name, is passed over. The last two are kept. At a
resume every row is also held against the scene (numbers, positions in the domain, particles of the
group, each there once): what cannot be ends it with one line and exit code 2.
"""
ABOUT_TABLES = """\
A row per frame and phase, numbers with all their digits. A row that was changed since is named with
its line where the table is read, and a resume refuses it, also one that lacks its last rows: the
checkpoint knows the `crc` of the last row before it. A last line without an end, cut off by a
kill, is left out. `crc` is `zlib.crc32(words, before)`: words are the bytes of the line before its
last comma, before is the crc of the line above, 0 in the first. Tables of earlier versions have no
`crc`, and get it at a resume.
"""


def _table(datasets, prefix=""):
    """Return a Markdown table of datasets."""
    lines = ["| name | shape | type | unit | meaning |", "|---|---|---|---|---|"]
    for d in datasets:
        kind = d.dtype.replace("|", " or ")
        words = (f"`{prefix}{d.name}`", d.shape, kind, d.unit, d.meaning)
        lines.append("| " + " | ".join(w.replace("|", "\\|") for w in words) + " |")
    return "\n".join(lines) + "\n"


ABOUT_ENERGY = (
    "Momentum and energy change by gravity, walls, colliders, loads, sources and sinks. With "
    "`domain.gravity_ramp` the potential energy is that of gravity at its full strength, with "
    "`domain.gravity_keyframes` that of gravity then.\n"
)


def page() -> str:
    """Return the text of docs/reference/file-format.md."""
    parts = [
        INTRODUCTION,
        "## frames/frame_00000.vtkhdf\n",
        "VTKHDF 2.0 PolyData, one part, rows in ascending `id`. A frame is known by its number: "
        "where one is missing the others keep theirs, and the renderer says which it leaves out. "
        "`id` and `x` are always there, "
        "the others as the scene asks for them. Covariance, opacity and colour are not repeated "
        "here: a renderer takes them from gaussians.h5 by `id` and moves them with F or J.\n",
        _table([d for d in file_layout.FRAME if d.name != "x"], "VTKHDF/PointData/"),
        _table([d._replace(name="Points") for d in file_layout.FRAME if d.name == "x"], "VTKHDF/"),
        _table(file_layout.FRAME_FIELD_DATA, "VTKHDF/FieldData/"),
        _table(file_layout.FRAME_TOPOLOGY, "VTKHDF/"),
        _table(file_layout.FRAME_OWN),
        "Attributes: `VTKHDF/Type`, `VTKHDF/Version`, and `/schema` (whole number). Frames of "
        "earlier versions have no `frame` and no `crc`: they are read, and nothing vouches for "
        "them. `gaussians` is the CRC32 of the checksums in gaussians.h5, those of its texts and "
        "`shade` left out, as JSON pairs in the order of their names; checkpoints have it too.\n",
        "## series.vtkhdf\n",
        "The frames one after the other, as virtual datasets of the same names: it holds no "
        "numbers itself and finds the frames beside it, from any working directory. It is valid "
        "after every frame.\n",
        _table(file_layout.SERIES_STEPS, "VTKHDF/"),
        _table(file_layout.SERIES_OWN),
        "## gaussians.h5\n",
        "A row per particle id, also for particles that are not there yet: frames hold those that "
        "are. Objects are contiguous, in the order of the scene; sources follow, layer by layer.\n",
        _table(file_layout.GAUSSIAN),
        "Drawn, but without mass (only if the scene has scenery):\n",
        _table(file_layout.SCENERY, "scenery/"),
        "Gaussians without mass that ride along (only if an object has `passive`). With weights w, "
        "carriers i and their deformation gradients F_i in a frame: x = sum w_i (x_i + F_i (x0 - "
        "x0_i)), F = sum w_i F_i, covariance F cov0 F^T.\n",
        _table(file_layout.PASSIVE, "passive/"),
        _table(file_layout.GAUSSIAN_TEXTS),
        "Attributes: `schema` (whole number), `digest` (text; says which preparation it is).\n",
        "## checkpoints/checkpoint_000000000.h5\n",
        "The number is the step. A group is one phase of one material: group_000, group_001, ... "
        "Rows stand in the order of the last sort, which is state: a resumed run goes on with "
        "the same bits on any number of ranks.\n",
        _table(file_layout.CHECKPOINT),
        _table(file_layout.CHECKPOINT_TEXTS),
        ABOUT_CHECKPOINTS,
        "## ledger.csv\n",
        ABOUT_TABLES,
        _table([*file_layout.LEDGER_COLUMNS, file_layout.ROW_CHECKSUM]),
        "Before `crc`, only with `[[source]]` or `[[sink]]`; count_in - count_out is `count`, "
        "exactly, and mass_in - mass_out is `mass`, to rounding:\n",
        _table(file_layout.OPEN_SYSTEM_COLUMNS),
        ABOUT_ENERGY,
        "## probe_NAME.csv\n",
        "A row per due time, written after the step that reaches it, numbers with all their "
        "digits; its columns by what the probe measures, and `crc` as in ledger.csv:\n",
        *(
            f"### {kind}\n\n{_table(columns)}"
            for kind, columns in file_layout.PROBE_COLUMNS.items()
        ),
    ]
    return "\n".join(parts)


if __name__ == "__main__":
    print(page(), end="")
