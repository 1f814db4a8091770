"""A wave that meets wood and stone has the same bits on three ranks: walls, free bodies and the
blocks between ranks in which one of them sums offsets and the other does not read them.
"""

from pathlib import Path

from tests.support.rank_states import by_id, different, state

SCENE = Path(__file__).parents[2] / "runs" / "driftwood" / "scene.toml"
STEPS = 340  # sums that came back with those of earlier steps left their range at step 327


def test_a_wave_that_meets_bodies(tmp_path):
    text = SCENE.read_text().replace('cell     = "1 cm"', 'cell     = "2 cm"')
    text = text.replace("[material.water]", '[accuracy]\npressure = "explicit"\n[material.water]')
    rows = []
    for n in (1, 3):
        folder = tmp_path / str(n)
        folder.mkdir()
        found, _ = state(folder, n, text, STEPS)
        rows.append(by_id(found))
    assert different(*rows) == []
