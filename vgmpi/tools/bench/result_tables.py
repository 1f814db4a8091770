"""The benchmark's results as text: the table of one run, two runs side by side."""

import numpy as np

ORDER = ("p2g", "halo", "grid", "g2p", "wait", "sort")


def per_step(row: dict, particles: int, clock: str = "seconds") -> np.ndarray:
    """Time of a particle and step [ns] of every round."""
    return np.array([1e9 * r[clock] / r["steps"] / particles for r in row["rounds"]])


def text(results: dict) -> str:
    """All that a run found."""
    lines = [_machine(results)]
    for group in results["groups"]:
        lines += ["", _heading(group), *_rows(group)]
    return "\n".join(lines)


def _machine(results: dict) -> str:
    m, roof = results["machine"], results["roof"]
    versions = ", ".join(f"{k} {v[:12]}" for k, v in results["versions"].items())
    lines = [f"{m['name']}, {m['cores']} cores, caches {m['caches']}", versions]
    if roof:
        for name in ("copy", "triad"):
            cores = ", ".join(f"{v:.1f} on {k}" for k, v in roof[name].items())
            lines.append(f"{name:5s}  {cores} core(s) [GB/s]")
        peak = ", ".join(f"{v:.0f} {k}" for k, v in roof["fma"].items())
        lines.append(f"fma    {peak} [GFlop/s per core]")
    return "\n".join(lines)


def _heading(group: dict) -> str:
    n, words = group["particles"], group["words"]
    return (
        f"{group['law']}, {n:,} particles: ns per particle and step, least and median of"
        f" {group['rounds']} rounds; at least {words} words ({4e-6 * words * n:.0f} MB in single"
        f" precision) and {group['flops']} flops"
    )


def stages_of(group: dict) -> list[str]:
    """Stages that any row has, in the order of a step."""
    present = {s for row in group["rows"] for r in row.get("rounds", []) for s in r["stages"]}
    return [s for s in ORDER if s in present] + sorted(present - set(ORDER))


def _label(row: dict) -> str:
    words = (row["name"], row["precision"], row["on"], row["cpu"])
    return " ".join(word for word in words if word)


def _rows(group: dict) -> list[str]:
    stages, n = stages_of(group), group["particles"]
    head = f"  {'':31s} {'time':>6s} {'median':>6s} {'Mpps':>6s}"
    head += "".join(f"{s:>6s}" for s in stages)
    head += f" {'floor':>6s} {'reached':>7s} {'speed':>7s} {'slower':>7s}"
    lines = [head]
    for row in group["rows"]:
        label = f"  {_label(row):31s}"
        if not row.get("rounds"):
            lines.append(f"{label} {row.get('note', 'not run')}")
            continue
        time = per_step(row, n)
        minimum, fastest = float(time.min()), row["rounds"][int(time.argmin())]
        line = f"{label} {minimum:6.1f} {np.median(time):6.1f} {1e3 / minimum:6.2f}"
        for stage in stages:
            spent = 1e9 * fastest["stages"].get(stage, 0.0) / fastest["steps"] / n
            line += f"{spent:6.1f}" if fastest["stages"] else f"{'':6s}"
        low = row.get("floor")
        line += f" {low:6.1f} {low / minimum:7.0%}" if low else f" {'-':>6s} {'-':>7s}"
        ratio = speed(group, row)
        line += f" {ratio:7.3f} {1 / ratio:7.2f}" if ratio else ""
        line += " (wall)" if row["clock"] == "wall" else ""
        lines.append(line)
        if "wrong" in row:
            lines.append(f"    {row['wrong']}")
    busy = _busy(group)
    if busy > 1.1:
        lines.append(
            f"  careful: other programs kept the cores busy ({busy:.2f} s passed per second of"
            " work); rows of wall time suffer most"
        )
    return lines


def _busy(group: dict) -> float:
    """Wall time over processor time of the rows on one core."""
    every = [r for row in group["rows"] if row["clock"] == "cpu" for r in row.get("rounds", [])]
    return sum(r["wall"] for r in every) / max(sum(r["seconds"] for r in every), 1e-9)


def speed(group: dict, row: dict) -> float | None:
    """Return the speed relative to the group's first row: median ratio of neighboring rounds.

    Rows measured by wall time are compared with the wall time of the first row.
    """
    first = group["rows"][0]
    if not (first.get("rounds") and row.get("rounds")):
        return None
    clock = "wall" if row["clock"] == "wall" else "seconds"
    n = group["particles"]
    return float(np.median(per_step(first, n, clock) / per_step(row, n, clock)))


def failures(results: dict) -> list[str]:
    """Rows that computed something else, and those whose program failed."""
    return [
        f"{group['law']}, {_label(row)}: {row.get('wrong', row.get('note'))}"
        for group in results["groups"]
        for row in group["rows"]
        if "wrong" in row or row.get("failed")
    ]


def compare(a: dict, b: dict) -> str:
    """Two runs side by side: time of each row in a and b, and b / a.

    The last column divides by what the plain numba loops, which do not change, did between the
    runs: the machine's pace.
    """
    lines = []
    if a["machine"] != b["machine"]:
        names = [f"{r['machine']['name']}, {r['machine']['cores']} cores" for r in (a, b)]
        lines.append(f"careful: measured on two machines: {names[0]} | {names[1]}")
    lines.append(" | ".join(f"{r['versions'].get('commit', '?')[:12]} {r['when']}" for r in (a, b)))
    theirs = {(g["law"], g["particles"]): g for g in b["groups"]}
    for group in a["groups"]:
        other = theirs.get((group["law"], group["particles"]))
        if other:
            lines += _side_by_side(group, other)
    if len(lines) == 1 + (a["machine"] != b["machine"]):
        lines.append("the two have no row in common")
    return "\n".join(lines)


def _side_by_side(group: dict, other: dict) -> list[str]:
    n = group["particles"]
    pairs = []
    for row in group["rows"]:
        for twin in other["rows"]:
            if _label(twin) == _label(row) and row.get("rounds") and twin.get("rounds"):
                pairs.append((row, per_step(row, n), per_step(twin, n)))
    pace = [np.median(y) / np.median(x) for row, x, y in pairs if row["module"] == "plain"]
    lines = [
        "",
        f"{group['law']}, {n:,} particles: ns per particle and step",
        f"  {'':31s} {'A':>7s} {'B':>7s} {'B / A':>7s} {'and least':>10s} {'at equal pace':>14s}",
    ]
    for row, x, y in pairs:
        ratio = np.median(y) / np.median(x)
        line = f"  {_label(row):31s} {np.median(x):7.1f} {np.median(y):7.1f} {ratio:7.3f}"
        line += f" {y.min() / x.min():10.3f}"
        lines.append(line + (f" {ratio / pace[0]:14.3f}" if pace else ""))
    return lines
