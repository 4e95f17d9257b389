"""What learning starts from: outputs at the mean percept, and intentions that are neighbours where demonstrations are alike."""

import torch
from jaxtyping import Float
from torch import Tensor

from preimage.data.sequences import Sequences
from preimage.network.coding import to_pixels
from preimage.network.intention import IntentionTable
from preimage.network.pdvmrnn import PDVMRNN


def start_from_demonstrations(model: PDVMRNN, sequences: Sequences) -> None:
    """Start the outputs at the mean percept and the intentions as neighbours where sequences are alike; keep the mean start as home."""
    pixels, codes = to_pixels(sequences.frames), model.coding.encode(sequences.joints)
    model.start_from_means(pixels.mean((0, 1)), codes.mean((0, 1)))
    model.home_pixels.copy_(pixels[:, 0].mean(0))
    model.home_joints.copy_(sequences.joints[:, 0].mean(0))
    model.longest.fill_(sequences.frames.shape[1])
    model.shortest.fill_(sequences.lengths.min())
    spread_intentions(model.intention_table, codes.flatten(1))


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
