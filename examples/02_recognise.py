"""What was meant? The intention of a sequence that was never shown is inferred, and the sequence regenerated from it.

    python examples/02_recognise.py --out demo

Recognition moves the intention until the imagined sequence resembles the sensed one at every step; the weights stay as they are.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro
from PIL import Image

import preimage as pi
from preimage.data.sequences import at_rate
from preimage.network.coding import to_frames


def main(out: Path = Path("demo"), seed: int = 11, quick: bool = False) -> None:
    """Recognise one sequence and compare what is regenerated with what was recorded.

    Args:
        out: folder for the picture.
        seed: draws the sequence.
        quick: search hardly at all, to see that everything runs.
    """
    options = pi.PlanOptions.regression()  # of a whole sequence there is nothing that a memory could add
    planner = pi.load_planner("reach", replace(options, iterations=1) if quick else options)
    model = planner.model
    (sequence,) = pi.record(pi.Arm(), pi.Reach(), count=1, seed=seed)
    found = planner.recognise(sequence)

    recorded = at_rate(sequence, model.config.rate_hz)
    frames = to_frames(found.generated.pixels[0]).cpu().numpy()
    joints = model.coding.decode(found.generated.log_codes[0].exp()).cpu().numpy()
    print(f"one intention regenerates {len(recorded)} steps, error {found.error:.2f}; {found.stopped.value}")
    for name, seen, felt in (
        ("regenerated", frames, joints),
        ("staying at the start", recorded.frames[:1], recorded.joints[:1]),
    ):
        greys = np.abs(seen.astype(float) - recorded.frames).mean()
        degrees = np.degrees(np.abs(felt - recorded.joints)).mean()
        print(f"{name:22s} off by {greys:5.2f} grey levels a pixel and {degrees:5.2f} degrees a joint, on average")

    chosen = np.linspace(0, len(recorded) - 1, 8).round().astype(int)
    rows = [np.concatenate(list(seen[chosen, :, :, 0]), axis=1) for seen in (recorded.frames, frames)]
    out.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(rows)).resize((8 * 128, 2 * 128), Image.Resampling.NEAREST).save(out / "recognised.png")
    print("recorded above, regenerated below:", out / "recognised.png")


if __name__ == "__main__":
    tyro.cli(main)
