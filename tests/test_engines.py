"""The network asks its engines in turn: what one answers stands, and where none does torch's own steps are taken."""

import pytest
import torch

from preimage import fast
from preimage.network import engines
from preimage.network.config import ModelConfig, Sensors
from preimage.network.pdvmrnn import PDVMRNN, Generated

SMALL = Sensors(16, 16, 1, ("a", "b"), (-1.0, -1.0), (1.0, 1.0))


def imagined_by(monkeypatch: pytest.MonkeyPatch, *asked: engines.Engine) -> Generated:
    monkeypatch.setattr(engines, "ENGINES", list(asked))
    model = PDVMRNN(ModelConfig.tiny(), SMALL)
    start = torch.zeros(1, 1, 16, 16), torch.full((1, 2, 10), 0.1)
    with torch.no_grad():
        return model.generate_closed_loop(model.intention_table.prior_mean(1), start, num_steps=3, dtype=torch.float32)


def test_the_first_engine_that_answers_runs_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, torch.dtype]] = []
    answer = torch.full((1, 3, 1, 16, 16), 0.25), torch.full((1, 3, 2, 10), -1.0)

    def declines(_model, _states, _start, num_steps, dtype):
        asked.append((num_steps, dtype))

    generated = imagined_by(monkeypatch, declines, lambda *_: answer, lambda *_: pytest.fail("asked after the answer"))
    assert asked == [(3, torch.float32)]
    assert generated.pixels is answer[0]
    assert generated.log_codes is answer[1]


def test_where_no_engine_answers_torch_does(monkeypatch: pytest.MonkeyPatch) -> None:
    alone, declined = imagined_by(monkeypatch), imagined_by(monkeypatch, lambda *_: None)
    torch.testing.assert_close(declined.pixels, alone.pixels, rtol=0, atol=0)


def test_the_compiled_loop_is_installed_once_and_only_beside_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "ENGINES", [])
    monkeypatch.setattr(fast, "is_available", lambda: False)
    fast.install()
    assert not engines.ENGINES
    monkeypatch.setattr(fast, "is_available", lambda: True)
    fast.install()
    fast.install()
    (installed,) = engines.ENGINES
    assert installed is fast.closed_loop_engine
