"""What each specialization of a scene costs to compile, in a cache of its own.

The scene runs in a process of its own until its first step is done: `time.end` is tiny.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

PROGRAM = """
import json, sys, time
from numba.core import event

class Costs(event.Listener):
    "Seconds of each compilation, without those within it."
    def __init__(self):
        self.open, self.rows = [], []
    def on_start(self, event):
        self.open.append([time.process_time(), 0.0])
    def on_end(self, event):
        began, inner = self.open.pop()
        total, data = time.process_time() - began, event.data
        if self.open:
            self.open[-1][1] += total
        function = data["dispatcher"].py_func
        name = f"{function.__module__}.{function.__qualname__}"
        kept = type(data["dispatcher"]._cache).__name__ == "ContentCache"
        self.rows.append([total - inner, total, kept, name, ", ".join(map(str, data["args"]))])

costs = Costs()
event.register("numba:compile", costs)
from vgmpi.commands import command_table
code = command_table.main(sys.argv[2:])
json.dump(costs.rows, open(sys.argv[1], "w"))
sys.exit(code)
"""


def measure(scene: Path, assignments: list[str]) -> list[list]:
    """Return rows of seconds alone, seconds with what is compiled within, whether it is kept, name
    and signature, the most expensive first.
    """
    with tempfile.TemporaryDirectory(prefix="vgmpi-cost-") as folder:
        rows = Path(folder) / "rows.json"
        words = [f"time.end={1e-9}", f"output.folder={folder}/run", *assignments]
        flags = [word for each in words for word in ("--set", each)]
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, str(rows), "run", str(scene), "-q", *flags],
            env={**os.environ, "NUMBA_CACHE_DIR": f"{folder}/code"},
            capture_output=True,
            text=True,
        )
        if not rows.exists():
            raise RuntimeError(done.stdout + done.stderr)
        return sorted(json.loads(rows.read_text()), reverse=True)


def text(rows: list[list], most: int) -> str:
    """Return the table."""
    lines = [
        f"{len(rows)} specializations, {sum(row[0] for row in rows):.1f} s of processor time",
        "   alone    with  kept  function (arguments)",
    ]
    for alone, total, kept, name, arguments in rows[:most]:
        brief = arguments if len(arguments) <= 90 else arguments[:87] + "..."
        lines.append(f"{alone:8.2f}{total:8.2f}  {'yes' if kept else 'no':4}  {name} ({brief})")
    return "\n".join(lines)
