"""What needs no torch does not wait for it: the names of the package, the overview of the verbs, and words that are off."""

import ast
import pickle
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import preimage
from preimage import cli
from preimage.cli.screen import remark

HEAVY = {"torch", "matplotlib", "mujoco", "numpy", "pyarrow", "av", "numba", "tyro"}
LOADED = f"import sys; print(sorted({HEAVY} & set(sys.modules)))"


def heavy_after(code: str) -> set[str]:
    """What of the heavy packages a fresh Python has loaded after this code, whatever exit that took."""
    text = f"try:\n    {code}\nexcept SystemExit:\n    pass\n{LOADED}"
    told = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    return set(ast.literal_eval(told.stdout.splitlines()[-1]))


@pytest.mark.parametrize(
    "code",
    [
        "import preimage",
        "from preimage.cli import main; main(['--help'])",
        "from preimage.cli import main; main(['--version'])",
        "from preimage.cli import main; main(['trian'])",
        "from preimage.cli import main; main([])",
    ],
)
def test_nothing_heavy_is_loaded(code):
    assert heavy_after(code) == set()


def test_a_name_loads_what_it_needs_and_no_more():
    assert heavy_after("from preimage import Percept") == {"numpy"}


def test_every_name_is_where_it_is_said_to_be():
    assert sorted(preimage.__all__) == sorted(preimage.ROOM_OF)
    for name in preimage.__all__:
        assert getattr(preimage, name) is getattr(import_module(f"preimage.{preimage.ROOM_OF[name]}"), name)
        assert name in dir(preimage)


def test_a_type_checker_reads_what_is_loaded():
    (block,) = (node for node in ast.parse(Path(preimage.__file__).read_text()).body if isinstance(node, ast.If))
    imported = {alias.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert imported == {name: f"preimage.{room}" for name, room in preimage.ROOM_OF.items()}


def test_a_name_that_is_not_there_is_named():
    with pytest.raises(AttributeError, match="module 'preimage' has no attribute 'plna'"):
        _ = preimage.plna
    with pytest.raises(ImportError, match="plna"):
        exec("from preimage import plna")


def test_what_is_loaded_late_can_be_pickled():
    assert pickle.loads(pickle.dumps(preimage.plan)) is preimage.plan
    assert pickle.loads(pickle.dumps(preimage.PDVMRNN)) is preimage.PDVMRNN


@pytest.mark.parametrize("verb", cli.VERBS)
def test_the_overview_says_what_the_verb_says_of_itself(verb):
    about = cli.VERBS[verb]
    function = getattr(import_module(f"preimage.cli.{about.room}"), about.function)
    assert about.summary == function.__doc__.splitlines()[0]
    assert f"  {verb:<9}  {about.summary}\n" in cli.overview()


@pytest.mark.parametrize(
    ("word", "sentence"),
    [("trian", "there is no verb trian: did you mean train?"), ("evalute", "there is no verb evalute: did you mean evaluate?")],
)
def test_the_verb_that_was_meant_is_found(refused, word, sentence):
    assert refused(word, "--out", "x") == (2, sentence)


def test_a_word_that_is_near_no_verb_is_answered_with_all(refused):
    code, sentence = refused("dance")
    assert code == 2
    assert sentence.endswith(f"there are {', '.join(cli.VERBS)}")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("plan run --gaol x --out y", "there is no option --gaol: did you mean --goal?"),
        ("record reach --count 1 --oot=x", "there is no option --oot: did you mean --out?"),
        ("train data --out x --view.croop 0 0 1 1", "there is no option --view.croop: did you mean --view.crop?"),
        ("train data --out x --As full", "there is no option --As: did you mean --as?"),
        ("check data --zzzzz", "there is no option --zzzzz: preimage check --help says which there are"),
        ("train data --out x --updates three", "--updates is three: give a whole number"),
        ("plan run --goal x --out y --rate-hz 10Hz", "--rate-hz is 10Hz: give a number"),
        ("train data --out x --view.size 1", "--view.size is 1: give 2 whole numbers"),
        ("train data --out x --view.crop=1 2 3 x", "--view.crop is 1 2 3 x: give 4 whole numbers"),
        ("check data --without-episodes 1-3 --out x", "--without-episodes is 1-3: give whole numbers, one after the other"),
        ("plan run --goal x --out y --goal-joints 1 '' x", "--goal-joints is 1 '' x: give numbers, one after the other"),
        ("train data --out x --size big", "--size is big: give tiny, small or paper"),
        ("train data --out x --as fool", "--as is fool: give paper, regression or full"),
        ("train data --out", "--out has no value: give one after it"),
    ],
)
def test_the_option_that_was_meant_is_found(refused, words, sentence):
    assert refused(*shlex.split(words)) == (2, sentence)


def test_both_spellings_of_an_option_are_one(refused):
    assert refused("train", "nowhere", "--out", "x", "--batch_size", "2") == (2, "nowhere is not a folder: name that of a data set")


def test_the_module_is_the_command():
    told = subprocess.run([sys.executable, "-m", "preimage", "--version"], capture_output=True, text=True, check=True)
    assert told.stdout == f"preimage {cli.version()}\n"


@pytest.mark.parametrize("verb", ["check", "plan", "evaluate"])  # one of each room
def test_a_missing_argument_is_told_without_what_the_work_needs(verb):
    assert not heavy_after(f"from preimage.cli import main; main(['{verb}', '--nonsense'])") & {"matplotlib", "mujoco", "pyarrow", "av"}


def test_the_page_is_up_before_a_network_is_loaded():
    pytest.importorskip("fastapi", reason="the extra `studio` is not installed")
    page = "from preimage import cli; from preimage.studio import server; server.uvicorn.Server.run = server.warm_up = lambda *_: None"
    assert heavy_after(f"{page}; cli.main(['studio', '--port', '0'])") == {"mujoco", "numpy", "pyarrow", "av", "tyro"}


def test_how_the_work_is_done_is_said_apart_from_what_comes_of_it(capsys):
    remark("threads: 1 (2 cores, 2 other threads at work)")
    assert capsys.readouterr() == ("", "threads: 1 (2 cores, 2 other threads at work)\n")
