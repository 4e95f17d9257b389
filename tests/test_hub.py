"""Runs go to the Hub and come back unchanged; only names that begin with hf: lead there. Nothing here touches the network."""

import inspect
import json
import shutil
from pathlib import Path

import huggingface_hub
import numpy as np
import pytest
from huggingface_hub import ModelCard, errors
from hypothesis import given
from hypothesis import strategies as st

import preimage
from preimage import cli
from preimage.storage import hub
from preimage.storage.runs import BUNDLED, find_run, read_body, read_view
from shared import make_demonstration

QUICK = preimage.PlanConfig(iterations=2, horizon=4)
REAL = {name: getattr(huggingface_hub, name) for name in ("snapshot_download", "upload_folder", "create_repo")}


class FakeHub:
    """A Hub that is a folder; what the true functions would not take, it does not take either."""

    def __init__(self, root: Path) -> None:
        self.root, self.fetched = root, 0

    def create_repo(self, *args, **words):
        asked = inspect.signature(REAL["create_repo"]).bind(*args, **words).arguments
        (self.root / asked["repo_id"]).mkdir(parents=True, exist_ok=asked["exist_ok"])

    def upload_folder(self, *args, **words):
        asked = inspect.signature(REAL["upload_folder"]).bind(*args, **words).arguments
        for path in Path(asked["folder_path"]).iterdir():
            if path.name in asked["allow_patterns"]:
                shutil.copy(path, self.root / asked["repo_id"])

    def snapshot_download(self, *args, **words):
        asked = inspect.signature(REAL["snapshot_download"]).bind(*args, **words).arguments
        self.fetched += 1
        if not (self.root / asked["repo_id"]).is_dir():
            raise web_error(errors.RepositoryNotFoundError)
        if asked["revision"] not in (None, "main"):
            raise web_error(errors.RevisionNotFoundError)
        cache = self.root / f"fetched {self.fetched}"
        shutil.copytree(self.root / asked["repo_id"], cache)
        return str(cache)


def web_error(kind: type[Exception]) -> Exception:
    error = kind.__new__(kind)  # made without the answer of a server, which each version of the package wants as another type
    Exception.__init__(error, "401 Client Error.\nmore of it")
    return error


@pytest.fixture
def fake_hub(tmp_path, monkeypatch) -> FakeHub:
    fake = FakeHub(tmp_path / "hub")
    for name in REAL:
        monkeypatch.setattr(huggingface_hub, name, getattr(fake, name))
    return fake


@pytest.fixture
def no_network(monkeypatch):
    def raising(error: Exception):
        def fail(*_args, **_words):
            raise error

        for name in REAL:
            monkeypatch.setattr(huggingface_hub, name, fail)

    return raising


def test_what_is_pushed_and_loaded_again_plans_to_the_digit_as_before(fake_hub, run_folder, demonstrations):
    assert preimage.push_to_hub(run_folder, "lab/tiny") == "https://huggingface.co/lab/tiny"
    start, goal = demonstrations[0].first, demonstrations[1].last
    before, after = (
        preimage.plan(preimage.from_pretrained(name), start=start, goal=goal, config=QUICK) for name in (run_folder, "hf:lab/tiny")
    )
    for part in ("frames", "joints", "errors", "intention"):
        np.testing.assert_array_equal(getattr(before, part), getattr(after, part))
    assert (before.error, before.arrival_step) == (after.error, after.arrival_step)


def test_the_memory_of_the_demonstrations_comes_along_where_there_is_one(fake_hub, run_folder, tmp_path):
    """Once it stayed behind, and nobody could plan with a run of the Hub by all ideas."""
    shutil.copytree(run_folder, tmp_path / "paper")
    (tmp_path / "paper" / "memory.safetensors").unlink()
    for run, name in ((run_folder, "lab/tiny"), (tmp_path / "paper", "lab/paper")):
        preimage.push_to_hub(run, name)
        there = find_run(f"hf:{name}")
        assert (there / "memory.safetensors").is_file() == (run / "memory.safetensors").is_file()
    assert preimage.load_planner("hf:lab/tiny").memory is not None


def test_all_that_a_verb_reads_of_a_run_comes_back(fake_hub, run_folder):
    preimage.push_to_hub(run_folder, "lab/tiny")
    there = find_run("hf:lab/tiny")
    assert {path.name for path in there.iterdir()} == {"config.json", "model.safetensors", "memory.safetensors", "shown.npz", "README.md"}
    assert (read_view(there), read_body(there)) == (read_view(run_folder), read_body(run_folder))
    for one, other in zip(preimage.read_shown(there), preimage.read_shown(run_folder), strict=True):
        np.testing.assert_array_equal(one.joints, other.joints)


def test_what_is_pushed_anew_is_loaded_anew(fake_hub, run_folder):
    preimage.push_to_hub("reach", "lab/changing")
    first = preimage.from_pretrained("hf:lab/changing")
    preimage.push_to_hub(run_folder, "lab/changing")
    assert preimage.from_pretrained("hf:lab/changing").config != first.config


def test_the_card_tells_its_licence_and_how_to_plan(fake_hub, run_folder):
    preimage.push_to_hub(run_folder, "lab/tiny", license="cc-by-4.0")
    card = ModelCard((fake_hub.root / "lab/tiny/README.md").read_text())
    told = card.data.to_dict()
    assert (told["library_name"], told["license"], told["pipeline_tag"]) == ("preimage", "cc-by-4.0", "robotics")
    assert "predictive-coding" in told["tags"]
    assert "preimage plan hf:lab/tiny --goal" in card.text
    assert "license" not in ModelCard((run_folder / "README.md").read_text()).data.to_dict(), "the run itself was changed"


def test_a_run_without_a_card_gets_one(fake_hub, run_folder, tmp_path):
    shutil.copytree(run_folder, tmp_path / "run")
    (tmp_path / "run/README.md").unlink()
    preimage.push_to_hub(tmp_path / "run", "lab/tiny")
    assert "3 demonstrations" in (fake_hub.root / "lab/tiny/README.md").read_text()


@pytest.mark.parametrize("name", BUNDLED)
def test_cards_of_the_bundled_models_tell_their_licence(name):
    assert ModelCard((find_run(name) / "README.md").read_text()).data.to_dict()["license"] == "mit"


def test_a_verb_takes_a_run_of_the_hub_and_fetches_it_once(fake_hub, capsys, run_folder, data, tmp_path):
    preimage.push_to_hub(run_folder, "lab/tiny")
    words = "--goal", f"{data}:0", "--out", str(tmp_path / "plan"), "--iterations", "1", "--horizon", "4"
    cli.main(["plan", "hf:lab/tiny@main", *words])
    assert "at step" in capsys.readouterr().out
    assert fake_hub.fetched == 1


@pytest.mark.parametrize("against", [["--goals", "1"], ["--data"]])
def test_evaluate_fetches_a_run_once(fake_hub, run_folder, tmp_path, against):
    preimage.push_to_hub(run_folder, "lab/tiny")
    if against == ["--data"]:
        preimage.save([make_demonstration(seed) for seed in (7, 8)], tmp_path / "data", task="reach")
        against = [*against, str(tmp_path / "data")]
    cli.main(["evaluate", "hf:lab/tiny", *against, "--out", str(tmp_path / "result.json"), "--iterations", "1", "--horizon", "4"])
    assert json.loads((tmp_path / "result.json").read_text())["model"] == "hf:lab/tiny"
    assert fake_hub.fetched == 1


@given(name=st.text(max_size=30))
def test_no_other_name_leads_to_the_network(name):
    assert hub.is_meant(name) == name.startswith("hf:")
    assert not hub.is_meant(Path(name.replace("\0", "")))


@pytest.mark.parametrize("name", ["reach", "lab/tiny", "hub:lab/tiny", Path("hf:lab/tiny")])
def test_a_folder_and_a_bundled_name_are_looked_for_here(fake_hub, name):
    try:
        preimage.from_pretrained(name)
    except ValueError as error:
        assert "or hf:OWNER/NAME of the Hugging Face Hub" in str(error)  # noqa: PT017, for reach loads
    assert fake_hub.fetched == 0


@pytest.mark.parametrize("name", ["hf:", "hf:reach", "hf:/reach", "hf:lab/", "hf:a/b/c", "hf:lab/reach@"])
def test_names_that_are_none_are_told_without_a_network(fake_hub, name):
    with pytest.raises(ValueError, match="is no name on the Hugging Face Hub: give hf:OWNER/NAME"):
        preimage.from_pretrained(name)
    assert fake_hub.fetched == 0


def test_no_such_repository_or_revision(fake_hub, refused, run_folder, tmp_path):
    words = "--goal", "goal.png", "--out", tmp_path / "plan"
    told = refused("plan", "hf:lab/none", *words)
    assert told == (2, "hf:lab/none is not on the Hugging Face Hub, or is private: check the name, or log in by `hf auth login`")
    preimage.push_to_hub(run_folder, "lab/tiny")
    with pytest.raises(ValueError, match="hf:lab/tiny has no revision v9: give a branch, a tag or a commit that it has"):
        preimage.from_pretrained("hf:lab/tiny", revision="v9")


def test_a_repository_that_holds_no_run(fake_hub):
    (fake_hub.root / "lab/words").mkdir(parents=True)
    (fake_hub.root / "lab/words/config.json").write_text(json.dumps({}))
    with pytest.raises(ValueError, match=r"hf:lab/words holds no run: it has no model.safetensors, no shown.npz; give one that"):
        preimage.from_pretrained("hf:lab/words")


NO_NETWORK = errors.LocalEntryNotFoundError("no"), web_error(errors.HfHubHTTPError), errors.HTTPError("no"), ConnectionError("no")


@pytest.mark.parametrize("error", NO_NETWORK)
def test_no_network(no_network, refused, tmp_path, error):
    no_network(error)
    code, sentence = refused("plan", "hf:lab/tiny", "--goal", "goal.png", "--out", tmp_path / "plan")
    assert (code, sentence) == (1, "hf:lab/tiny was not fetched before, and the Hugging Face Hub cannot be reached: try again later")


@pytest.mark.parametrize("error", [errors.HTTPError("no"), ConnectionError("no")])
def test_pushing_without_a_network(no_network, run_folder, error):
    no_network(error)
    with pytest.raises(ConnectionError, match="hf:lab/tiny cannot be written, for the Hugging Face Hub cannot be reached"):
        preimage.push_to_hub(run_folder, "lab/tiny")


def test_pushing_without_a_login(no_network, run_folder):
    no_network(web_error(errors.HfHubHTTPError))
    with pytest.raises(ValueError, match=r"hf:lab/tiny cannot be written \(401 Client Error.\): log in by `hf auth login`"):
        preimage.push_to_hub(run_folder, "lab/tiny")


def test_pushing_to_a_revision(fake_hub, run_folder):
    with pytest.raises(ValueError, match="hf:lab/tiny@v1 names a revision, and a run is sent to the newest: give hf:lab/tiny"):
        preimage.push_to_hub(run_folder, "lab/tiny@v1")


def test_a_revision_of_what_is_not_on_the_hub():
    with pytest.raises(ValueError, match="revision is v1, and reach is not on the Hugging Face Hub: give hf:OWNER/NAME"):
        preimage.from_pretrained("reach", revision="v1")
