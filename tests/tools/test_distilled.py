"""Score distillation by hand, on guesses that are known."""

import pytest

from vgmpi.tools.fit.video_prior import score_distillation

torch = pytest.importorskip("torch")


class Says:
    """In place of a model: its guess is always this."""

    def __init__(self, guesses):
        self.conditions = guesses

    def predict(self, z_t, level, condition):
        return condition


def test_a_pull_by_hand():
    """w (u + g (c - u) - eps), w the share of the noise in the variance."""
    level = score_distillation.Level(0.6, 0.3, 0)
    one = score_distillation.draw(level, (1, 2, 1, 3, 3), 7, 0)
    kind = Says((torch.tensor(0.25), torch.tensor(0.5)))
    found, loss = score_distillation.sds_gradient(kind, torch.zeros(1, 2, 1, 3, 3), one, 4.0)
    weight = 0.09 / (0.36 + 0.09)
    assert torch.allclose(found, weight * (0.25 + 4 * 0.25 - one.eps))
    assert loss == pytest.approx(float(((0.5 - one.eps) ** 2).mean()), rel=1e-6)
    assert score_distillation.Level(0.8, 0.6, 0).weight == pytest.approx(
        0.36
    )  # as 1 - alphas_cumprod
