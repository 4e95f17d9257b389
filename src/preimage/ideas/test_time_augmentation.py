"""Test-time augmentation: a plan's joints are the mean of what is imagined from the start frame and from the same moved a little.

What a network makes of a picture that it never saw is a little off, and off otherwise where the picture lies a little elsewhere. Moved to
all sides alike, it errs by as much to one side as to the other, so that the mean of all looks is nearer than one. How far apart they are
says how sure it is.

>>> dot = torch.zeros(1, 1, 4, 4)
>>> dot[0, 0, 1, 1] = 1.0
>>> shifted(dot, torch.tensor([[0.5, 1.0]]))[0, 0].tolist()  # half a pixel to the right, one down
[[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [0.0, 0.5, 0.5, 0.0], [0.0, 0.0, 0.0, 0.0]]
"""

import itertools
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from preimage.method.plan import draft_of
from preimage.method.seam import Draft, Objective, Problem
from preimage.network.intention import IntentionState
from preimage.network.pdvmrnn import Generated
from preimage.records import Spread


def shifted(pictures: Float[Tensor, "B C H W"], by: Float[Tensor, "B 2"]) -> Float[Tensor, "B C H W"]:
    """Each picture moved to the right and down by so many pixels, between pixels linearly; at the edges it goes on as it ends.

    Args:
        by: pixels to the right and down.
    """
    height, width = pictures.shape[-2:]
    here = torch.eye(2, device=by.device, dtype=by.dtype).expand(len(by), 2, 2)
    moved = torch.cat([here, -2 * torch.stack([by[:, 0] / width, by[:, 1] / height], dim=-1)[..., None]], dim=-1)
    places = nn.functional.affine_grid(moved, list(pictures.shape), align_corners=False)
    return nn.functional.grid_sample(pictures, places, padding_mode="border", align_corners=False)


@dataclass(frozen=True)
class TestTimeAugmentation:
    """The mean over a start frame as it is and moved to its eight sides."""

    __test__ = False  # for pytest, which takes the name for a test's
    by: float
    """Heights of a frame by which it is moved."""

    def looks(self, picture: Float[Tensor, "C H W"]) -> Float[Tensor, "looks C H W"]:
        """A picture as it is, first, and moved to its eight sides."""
        sides = sorted(itertools.product((-1.0, 0.0, 1.0), repeat=2), key=any)  # to no side first
        return shifted(picture.expand(len(sides), *picture.shape), self.by * picture.shape[1] * picture.new_tensor(sides))

    @torch.no_grad()
    def __call__(self, intention: IntentionState, problem: Problem, objective: Objective, *, generated: Generated | None = None) -> Draft:
        draft = draft_of(intention, problem, objective, generated=generated)
        model, moved = problem.model, self.looks(problem.start[0])[1:]
        start, rows = (moved, problem.start[1].expand(len(moved), -1, -1)), torch.zeros(len(moved), dtype=torch.long)
        others = model.generate_closed_loop(intention[rows], start, num_steps=problem.num_steps, dtype=problem.dtype)
        log_codes = torch.cat([draft.generated.log_codes, others.log_codes])
        looks = model.coding.decode(log_codes.exp()).double()
        shares = looks[:, : draft.arrival + 1] / (model.coding.upper - model.coding.lower)
        pictures = torch.cat([each.pixels[:, draft.arrival] for each in (draft.generated, others)]).float()
        of_joints, of_pictures = (float(each.var(0, unbiased=False).mean()) for each in (shares, pictures))
        joints = looks.mean(0)
        return replace(draft, joints=joints, imagined=joints, spread=Spread(of_joints**0.5, of_pictures))
