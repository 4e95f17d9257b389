"""What all tests share: shapes are checked at every call, and the recordings, the data set and the run that several of them use."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, wraps
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from beartype import BeartypeConf, beartype
from beartype.roar import BeartypeDecorHintPep673Exception, BeartypeDecorHintPep3119Exception
from hypothesis import settings
from jaxtyping import config, install_import_hook

settings.register_profile("preimage", deadline=None)  # a busy machine is no failure
settings.load_profile("preimage")


LEFT_OUT = {"robot", "fast", "studio", "method/plan.py", "network/linear.py", "network/cells.py"}
"""Wings and rooms whose tests hand them wrong shapes to read the refusal, whose annotations are narrower than what they pass on, whose
small functions are called at every step of every layer and would take the suite past its time, whose functions numba reads as they are,
or whose libraries need not be installed."""
SOURCE = Path(__file__).parents[1] / "src"
ROOMS = [
    ".".join(parts).removesuffix(".py")
    for parts in (path.relative_to(SOURCE).parts for path in sorted((SOURCE / "preimage").rglob("*.py")))
    if parts[-1] not in ("__init__.py", "__main__.py") and not LEFT_OUT & {parts[1], "/".join(parts[1:])}
]


def checked(function: Callable) -> Callable:
    """The function with its annotations enforced from its first call on: what a process never calls, it need not prepare to check."""
    enforce = cache(lambda: enforced(function))

    @wraps(function)
    def call(*args, **kwargs):
        return enforce()(*args, **kwargs)

    return call


def enforced(function: Callable) -> Callable:
    """The function with its annotations enforced, except where one names `Self` or a protocol that cannot be checked at runtime."""
    try:
        return beartype(conf=BeartypeConf(is_pep484_tower=True))(function)  # an int will do for a float
    except (BeartypeDecorHintPep673Exception, BeartypeDecorHintPep3119Exception):
        return function


with install_import_hook(ROOMS, "shared.checked"):
    for room in ROOMS:  # at once: what is loaded later than this goes unchecked
        import_module(room)
    import preimage
    from bars import bars, learned
    from preimage.cli import main
    from preimage.network.config import ModelConfig
    from preimage.presets import remember
    from preimage.records import Demonstration, Scene
    from preimage.robot import TASKS, Arm, Reach, record
    from recordings import noises

ARM_JOINTS = Arm().joint_names


def make_demonstration(
    seed: int = 0, *, num_steps: int = 6, size: tuple[int, int, int] = (64, 64, 1), num_joints: int = 4, rate_hz: float = 10.0
) -> Demonstration:
    """A bright square that wanders across a grey picture, and joints that wander with it; with four joints those of the arm."""
    height, width, channels = size
    rng = np.random.default_rng(seed)
    names = ARM_JOINTS if num_joints == 4 else tuple(f"joint {number}" for number in range(num_joints))
    scene = Reach().sample(rng) if num_joints == 4 else None
    start = np.array(scene.start_joints) if scene else np.zeros(num_joints)
    way = np.linspace(0, 1, num_steps)[:, None]
    joints = start + way * rng.uniform(-0.5, 0.5, num_joints)
    frames = np.full((num_steps, height, width, channels), 90, np.uint8)
    begin, end = np.array([height // 2, width // 2]), rng.integers(0, (height * 3 // 4, width * 3 // 4))
    for step in range(num_steps):
        row, column = (begin + way[step] * (end - begin)).astype(int)
        frames[step, row : row + height // 4, column : column + width // 4] = 220
    return Demonstration(frames, joints, rate_hz, tuple(names), scene)


@pytest.fixture(scope="session", autouse=True)
def by_torch() -> Iterator[None]:
    """Tiny networks of the tests go the way of the large ones; `test_compiled` says that the other way leads to the same."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("preimage.network.engines.ENGINES", [])
        patch.setattr("preimage.cli.screen.LINE_EVERY_S", 1e6)  # a busy machine is no reason for a line more
        yield


@pytest.fixture(scope="session")
def demonstrations() -> list[Demonstration]:
    """Three short recordings with the arm's joints, each in a scene of the task `reach`; nothing was simulated for them."""
    return [make_demonstration(seed, num_steps=6 + seed) for seed in range(3)]


@pytest.fixture(scope="session")
def data(demonstrations, tmp_path_factory):
    """The recordings as a data set."""
    folder = tmp_path_factory.mktemp("data") / "three"
    preimage.save(demonstrations, folder, task="reach", joint_unit="rad")
    return folder


@pytest.fixture
def noisy() -> list[Demonstration]:
    """Three recordings of noise, which no reader could guess."""
    return noises()


@pytest.fixture
def folder(noisy, tmp_path) -> Path:
    """They as a data set, for damage to be done to."""
    preimage.save(noisy, tmp_path / "data", task="reach the mark", joint_unit="rad")
    return tmp_path / "data"


@pytest.fixture(scope="session")
def run_folder(data, tmp_path_factory):
    """A run that was trained by the command line, for two updates: it knows nothing, but all its files are there."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    main(["train", str(data), "--out", str(folder), "--size", "tiny", "--updates", "2"])
    return folder


@pytest.fixture(scope="session")
def model(run_folder):
    return preimage.load_model(run_folder)


@pytest.fixture(scope="session")
def trained():
    """A network with a latent intention that learned six bars a little."""
    with without_checks():  # they take several times as long as the learning
        return learned(replace(ModelConfig.tiny(), intention_cost=1e-3))


@pytest.fixture(scope="session")
def trained_as_paper():
    """The same with the paper's intention."""
    with without_checks():
        return learned(ModelConfig.tiny().as_paper())


@pytest.fixture(scope="session")
def memory(trained):
    """Of the six bars."""
    return remember(bars(), trained)


@pytest.fixture(scope="session")
def scene(demonstrations) -> Scene:
    return demonstrations[0].scene


@pytest.fixture
def refused(capsys):
    """Runs words that cannot work; the exit code and the sentence, after a check that it is one and that there is nothing else."""

    def run(*words: object) -> tuple[int, str]:
        with pytest.raises(SystemExit) as left:
            main([str(word) for word in words])
        told = capsys.readouterr()
        assert told.out == ""
        assert told.err.startswith("preimage: ")
        assert told.err.count("\n") == 1
        assert told.err.endswith("\n")
        return left.value.code, told.err.removeprefix("preimage: ").strip()

    return run


@pytest.fixture(scope="module")
def studio(run_folder, data, tmp_path_factory):
    """The studio of a run that knows nothing, on the simulated table."""
    from studios import opened  # whose libraries need not be installed

    return opened(run_folder, [data], tmp_path_factory.mktemp("work"))


@pytest.fixture(scope="module")
def page(studio):
    """What a browser would ask the studio."""
    from studios import client

    return client(studio)


@pytest.fixture(scope="module")
def found(page) -> str:
    """A plan to the middle of the table, once for each file."""
    from studios import MIDDLE, events_of, planned

    job = planned(page, page.post("/api/goals/place", json=MIDDLE).json())
    assert events_of(page, job)[-1]["event"] == "done"
    return job


@pytest.fixture
def plan(found, studio) -> str:
    """It, as if it were just found: nothing was executed, nobody went on anyway."""
    made = studio.jobs.find(found).result
    made.trial, made.anyway = None, False
    return found


@pytest.fixture(scope="session")
def browser():
    """A browser for all the tests of pages."""
    from browsing import chromium

    with chromium() as browser:
        yield browser


@contextmanager
def without_checks() -> Iterator[None]:
    config.update("jaxtyping_disable", True)
    yield
    config.update("jaxtyping_disable", False)


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Shapes are not checked, as it is outside of the tests: for what a user gets to read where shapes are wrong."""
    with without_checks():
        yield


@pytest.fixture(scope="session")
def recorded():
    """Demonstrations of every task, by name, recorded once."""
    arm = Arm()
    return {name: record(arm, task, count=2, seed=0) for name, task in TASKS.items()}
