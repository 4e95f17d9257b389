"""Laws of test-time augmentation: whole pixels move as they are, all eight sides are looked from, and a way is the mean of all."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bars import REGRESSION, SOLVED, bar, objective_of, problem_to
from preimage.ideas.test_time_augmentation import TestTimeAugmentation, shifted
from preimage.method.plan import draft_of
from preimage.network.coding import to_frames
from preimage.network.inputs import as_inputs
from preimage.network.pdvmrnn import PDVMRNN
from preimage.presets import Planner, PlanOptions
from preimage.records import Percept


def pictures(count: int = 1) -> torch.Tensor:
    return torch.rand(count, 2, 6, 8, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(("right", "down"), [(0, 0), (1, 0), (0, 2), (2, 1), (3, 3)])
def test_a_shift_by_whole_pixels_moves_them_as_they_are(right: int, down: int) -> None:
    one = pictures()
    moved = shifted(one, torch.tensor([[float(right), float(down)]]))
    torch.testing.assert_close(moved[..., down:, right:], one[..., : 6 - down, : 8 - right])
    torch.testing.assert_close(moved[0, :, :down, right:], one[0, :, :1, : 8 - right].expand(-1, down, -1))  # the edge goes on


def test_each_picture_is_moved_by_its_own_shift() -> None:
    two = pictures(2)
    together = shifted(two, torch.tensor([[0.5, -1.0], [-2.0, 0.25]]))
    apart = torch.cat([shifted(two[:1], torch.tensor([[0.5, -1.0]])), shifted(two[1:], torch.tensor([[-2.0, 0.25]]))])
    torch.testing.assert_close(together, apart)


def test_a_picture_is_looked_at_first_and_then_from_all_eight_sides() -> None:
    one = pictures()[0]
    seen = TestTimeAugmentation(1 / 6).looks(one)  # a pixel
    torch.testing.assert_close(seen[0], one)
    inner = {tuple(look[:, 1:-1, 1:-1].flatten().tolist()) for look in seen}
    around = {tuple(one[:, 1 + y : 5 + y, 1 + x : 7 + x].flatten().tolist()) for x in (-1, 0, 1) for y in (-1, 0, 1)}
    assert len(seen) == len(inner) == 9
    torch.testing.assert_close(torch.tensor(sorted(inner)), torch.tensor(sorted(around)))


def test_a_way_is_the_mean_of_what_is_imagined_from_all_looks(trained: PDVMRNN) -> None:
    start = bar(0.3).first
    plain, together = Planner(trained, None, REGRESSION), Planner(trained, None, replace(REGRESSION, test_time_augmentation=0.05))
    alone = [plain.imagine_without_goal(start)]
    pixels, _ = as_inputs(trained, start, name="start")
    for look in TestTimeAugmentation(0.05).looks(pixels)[1:]:
        alone.append(plain.imagine_without_goal(Percept(to_frames(look).numpy(), start.joints)))
    mean = together.imagine_without_goal(start)
    np.testing.assert_allclose(mean.joints, np.mean([one.joints for one in alone], 0), atol=2e-3)  # frames are of whole grey levels
    np.testing.assert_array_equal(mean.frames, alone[0].frames)
    assert np.abs(mean.joints - alone[0].joints).max() > 1e-4
    np.testing.assert_array_equal(mean.joints, mean.imagined_joints)


def test_the_spread_is_that_of_what_is_imagined_from_all_looks(trained: PDVMRNN) -> None:
    """Joints up to the arrival in shares of their ranges, pictures of the arrival in half ranges."""
    problem = problem_to(trained, bar(0.3))
    objective, intention = objective_of(problem), problem.space.intention(problem.space.training[:1])
    together = TestTimeAugmentation(0.05)
    draft = together(intention, problem, objective)
    assert draft.spread is not None
    assert draft.arrival > 0
    looks = [replace(problem, start=(look, problem.start[1])) for look in together.looks(problem.start[0])]
    alone = [draft_of(intention, look, objective) for look in looks]
    ranges = trained.coding.upper - trained.coding.lower
    joints = torch.stack([each.joints[: draft.arrival + 1] for each in alone]) / ranges
    frames = torch.stack([each.generated.pixels[0, draft.arrival] for each in alone])
    assert draft.spread.joints == pytest.approx(joints.var(0, unbiased=False).mean().sqrt().item(), rel=1e-3)
    assert draft.spread.picture == pytest.approx(frames.var(0, unbiased=False).mean().item(), rel=1e-3)
    assert alone[0].spread is None


def test_what_the_search_has_imagined_is_not_imagined_again(trained: PDVMRNN, monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[int] = []
    imagine = PDVMRNN.generate_closed_loop
    monkeypatch.setattr(PDVMRNN, "generate_closed_loop", lambda *given, **more: (counts.append(len(given[1])), imagine(*given, **more))[1])
    planner = Planner(trained, None, replace(SOLVED, test_time_augmentation=0.05))
    planner.imagine_without_goal(bar(0.3).first)
    assert counts == [1, 8]
    planner.plan(goal=bar(0.3).last)
    assert counts[-1] == 8
    assert counts.count(1) == 1


def test_no_side_is_looked_from_unless_it_is_asked_for(trained: PDVMRNN) -> None:
    assert PlanOptions.full().augmentation() is not None
    assert REGRESSION.augmentation() is PlanOptions.paper().augmentation() is None
