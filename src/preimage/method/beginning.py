"""What a network is given of the demonstrations before it learns: means to start from, and a memory of what it was shown."""

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.data.sequences import Sequences
from preimage.ideas.gripper_events import find_switches
from preimage.ideas.image_features import BLUR, apart, arrived, blurred
from preimage.method.prediction_error import proprioceptive_error
from preimage.network.coding import to_pixels
from preimage.network.intention import IntentionTable
from preimage.network.pdvmrnn import PDVMRNN


def start_from(model: PDVMRNN, sequences: Sequences) -> None:
    """Start the outputs at the mean percept of the demonstrations; keep their mean first percept as home, and how each began and ended."""
    pixels, codes = to_pixels(sequences.frames), model.coding.encode(sequences.joints)
    model.start_from_means(pixels.mean((0, 1)), codes.mean((0, 1)))
    model.longest.fill_(sequences.frames.shape[1])
    keep_pictures(model, pixels[:, 0], pixels[:, -1])
    keep_joints(model, sequences.joints)
    spread_intentions(model.intention_table, codes.flatten(1))


def keep_pictures(model: PDVMRNN, first: Float[Tensor, "N C H W"], last: Float[Tensor, "N C H W"]) -> None:
    """Keep what is usually seen, what stood in each first frame and came to stand in each last, and the last frames."""
    model.home_pixels.copy_(first.mean(0))
    model.usual_start.copy_(first.median(0).values)
    model.background.copy_(last.median(0).values)
    model.shown_starts.copy_(apart(first - model.usual_start))
    model.shown_arrivals.copy_(arrived(first, last, model.background))
    model.shown_lasts.copy_(blurred(last, BLUR))


def keep_joints(model: PDVMRNN, joints: Float[Tensor, "N T J"]) -> None:
    """Keep where the joints stood as each began, switched something and ended."""
    model.home_joints.copy_(joints[:, 0].mean(0))
    model.shown_firsts.copy_(joints[:, 0])
    model.starts_apart.fill_(usually_apart(model.coding.encode(joints[:, 0])))
    model.shown_ends.copy_(joints[:, -1])
    model.shown_switches.copy_(joints[:, -1:])
    if found := find_switches(joints):
        count = found.steps.shape[1]
        model.shown_switches[:, :count] = joints[torch.arange(len(joints))[:, None], found.steps]
        model.switching.copy_(torch.tensor([found.joint, count]))


def usually_apart(codes: Float[Tensor, "N J K"]) -> float:
    """The distance within which nine in ten have another, in the error of codes (nats); of a single one 0."""
    log_codes = codes.clamp(min=1e-12).log()
    distances = torch.stack([proprioceptive_error(log_codes, one) for one in codes]).fill_diagonal_(torch.inf)
    return float(distances.amin(1).quantile(0.9)) if len(codes) > 1 else 0.0


def spread_intentions(table: IntentionTable, features: Float[Tensor, "N F"], components: int = 16) -> None:
    """Start the intentions where alike sequences are neighbours: at their principal components.

    The paper starts them at random. From there, learning first has to find out what an intention could be good for; from here it
    can begin with the demonstrations themselves.
    """
    centred = features - features.mean(0)
    directions, sizes, _ = torch.linalg.svd(centred, full_matrices=False)
    components = min(components, len(features))
    weights = (sizes / sizes[0].clamp(min=1e-9)).clamp(min=0.15)[:components]  # small components count, or no two would differ
    scores = len(features) ** 0.5 * directions[:, :components] * weights
    table.start_from(scores, torch.Generator().manual_seed(components))
