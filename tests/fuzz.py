"""The whole program on inputs that are damaged, and words that are off: whatever comes, it ends in one sentence.

    python tests/fuzz.py 10000                  so many cases (`make fuzz`); what went wrong is told once a kind, with its numbers
    python tests/fuzz.py 1 --first 4711         one case again, told in full

A case is all that its number draws: an input, what is damaged in it, and a command line. The command runs in a process forked from one that
has everything loaded, in a folder of its own. `test_fuzz` draws the same cases by hypothesis, which makes them smaller where one fails.

The laws: exit code 0, 1 or 2; one sentence where it is not 0; no text of a library and no error of ours; at most 30 s of computing and 2 GB
of memory; the input is as it was, and nothing half-written is left.
"""

import argparse
import contextlib
import gc
import hashlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

from fuzz_cases import VERBS, Case, case_of

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

LONGEST_S, LONGEST_WAIT_S, MOST_BYTES = 30, 120.0, 2 << 30
"""Seconds of computing, seconds on the clock (on a machine that others use too), and bytes of memory that a command may take."""
LEFT_OUT = re.compile("--(out|help|device|size|resume|overwrite|results|readme|work|goal|data)$")
"""Options that are no part of the words that are off: where to write, and what a case says itself."""


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int | None
    """None where it had to be killed."""
    out: str
    err: str
    seconds: float
    most_bytes: int


# Valid inputs


def make_inputs(place: Path) -> Path:
    """One small valid input of every kind, in a folder."""
    from PIL import Image

    import preimage
    from preimage.robot import TASKS, Arm, record, with_frames
    from recordings import INFO, edit_json, write_plain, write_v21, write_v30

    demonstrations = record(Arm(), with_frames(TASKS["reach"], 32), count=3, seed=0)
    preimage.save(demonstrations, place / "ours", task="reach", joint_unit="rad")
    write_v21(place / "v21", lengths=(9, 8), size=(48, 64))
    write_v30(place / "v30", lengths=(9, 8, 7), size=(48, 64))
    shutil.copytree(place / "v21", place / "v20")
    edit_json(place / "v20" / INFO, lambda info: info.update(codebase_version="v2.0"))
    write_plain(place / "plain", lengths=(9, 8), size=(48, 64))
    run(["train", str(place / "ours"), "--out", str(place / "run"), "--size", "tiny", "--updates", "2"])
    run(["plan", str(place / "run"), "--goal", f"{place / 'ours'}:1", "--out", str(place / "plan"), "--iterations", "1"])
    Image.fromarray(demonstrations[0].frames[-1][..., 0]).save(place / "goal.png")
    limits = {"joint1": {"lower": -1.0, "upper": 1.0, "velocity": 1.0}, "joint2": {"step": 0.2}}
    (place / "limits.json").write_text(json.dumps(limits))
    (place / "results").mkdir()
    for name in ("bench.json", *sorted(path.name for path in (HERE.parent / "results").glob("*reach*.json"))[:4]):
        shutil.copy(HERE.parent / "results" / name, place / "results")
    (place / "README.md").write_text((HERE.parent / "README.md").read_text())
    return place


def run(words: list[str]) -> None:
    from preimage.cli import main

    main(words)


# Laws


def broken_law(case: Case, ended: Ended, before: str, after: str, left: list[str]) -> str | None:
    """What of the laws does not hold, in a few words that are alike for alike faults; None where all hold."""
    verb = case.words[0] if case.words else "nothing"
    if ended.code in (None, -signal.SIGXCPU, -signal.SIGKILL):
        return f"{verb} takes more than {LONGEST_S} s" if ended.code else f"{verb} waits for ever"
    if ended.most_bytes > MOST_BYTES:
        return f"{verb} takes {ended.most_bytes / 2**30:.1f} GB"
    if found := re.search(r"an error inside preimage \((.*?)\)", ended.err):
        return found[1]
    if "Traceback (most recent call last)" in ended.err:
        return f"traceback: {ended.err.strip().splitlines()[-1]}"
    if "memory of this machine" in ended.err or "memory of the device" in ended.err:
        return f"{verb} wants more memory than there is"
    if ended.code not in (0, 1, 2):
        return f"{verb} ends with {ended.code}"
    if found := re.search(r"^.*Warning.*$", ended.err, re.MULTILINE):
        return found[0].split("/")[-1]
    sentences = [line for line in ended.err.splitlines() if line.startswith("preimage: ")]
    from_words = ended.err.startswith("╭─")  # what tyro says of words that fit no option
    verdict = verb == "check" and ended.code == 1 and ended.out.strip()
    if ended.code and len(sentences) != 1 and not from_words and not verdict:
        return f"{verb} says {len(sentences)} sentences for code {ended.code}"
    if case.keeps and before != after:
        return f"{verb} changes its input"
    if left:
        return f"{verb} leaves {re.sub(r'[0-9]+@.*?[.]', 'PID.', left[0])}"
    return None


def state_of(place: Path) -> str:
    """All names, kinds and contents of a folder, in a digest."""
    digest = hashlib.sha256()
    for path in sorted(place.rglob("*")):
        kind = path.lstat().st_mode
        content = path.read_bytes() if path.is_file() and not path.is_symlink() else b""
        digest.update(f"{path.relative_to(place)} {kind} {len(content)} ".encode(errors="surrogateescape") + content)
    return digest.hexdigest()


@dataclass(frozen=True)
class Fault:
    law: str
    case: Case
    ended: Ended

    def __str__(self) -> str:
        told = self.ended.err.encode(errors="replace").decode()[-1500:]
        what = f"{self.law}\n  words: {self.case.words}\n  damages: {self.case.damages}"
        return f"{what}\n  code {self.ended.code} after {self.ended.seconds:.1f} s\n  {told}"


class Program:
    """The program, loaded once, forked for every command."""

    def __init__(self) -> None:
        self.place = Path(tempfile.mkdtemp(prefix="preimage-fuzz-"))
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "TMPDIR": str(self.place / "tmp"), "HF_HUB_OFFLINE": "1", "COLUMNS": "120"}
        (self.place / "tmp").mkdir()
        self.inputs = self.place / "inputs"
        self.inputs.mkdir()
        words = [sys.executable, __file__, "--serve", str(self.inputs)]
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)
        self.options = self._read()

    def _read(self) -> Any:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, "the program to be forked is gone"
        return json.loads(line)

    def run(self, words: list[str], place: Path, *, by: int = signal.SIGKILL, after_s: float | None = None) -> Ended:
        """Run a command; `after_s` seconds from its start it gets the signal `by`, unless it has ended."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"words": words, "place": str(place), "by": by, "after_s": after_s}) + "\n")
        self.process.stdin.flush()
        return Ended(**self._read())

    def fault_of(self, chance: Random) -> Fault | None:
        """Draw a case, run it, and hold the laws against what came of it."""
        scratch = Path(tempfile.mkdtemp(dir=self.place))
        try:
            case = case_of(chance, self.inputs, scratch, self.options)
            kept, names = state_of(scratch), {path.name for path in scratch.iterdir()}
            ended = self.run(case.words, scratch)
            left = [path.name for path in scratch.rglob(".*") if re.search(r"\.part$|\.former$|^\.lock$", path.name)]
            for path in [each for each in scratch.iterdir() if each.name not in names]:
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
            law = broken_law(case, ended, kept, state_of(scratch), left)
            return Fault(law, case, ended) if law else None
        finally:
            shutil.rmtree(scratch, ignore_errors=True)

    def close(self) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.close()
        self.process.wait()
        shutil.rmtree(self.place, ignore_errors=True)


# The process that is forked


def serve(inputs: Path) -> None:
    """Load everything, make the inputs, say which options there are, then fork a command for every line that comes."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    from importlib import import_module

    from preimage.network import engines

    engines.ENGINES[:] = []  # compiling for every size of frames would take longer than the case
    for room in sorted((HERE.parent / "src/preimage").rglob("*.py")):
        name = ".".join(room.relative_to(HERE.parent / "src").with_suffix("").parts).removesuffix(".__init__")
        if not name.endswith(("__main__", "gym")):
            import_module(name)
    if not (inputs / "run").exists():
        make_inputs_elsewhere(inputs)
    gc.freeze()  # collecting would write to every page that is shared with a fork
    options = {verb: options_of(verb) for verb in VERBS}
    print(json.dumps(options), file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(vars(forked(**json.loads(line)))), file=answers, flush=True)


def make_inputs_elsewhere(inputs: Path) -> None:
    """Make the inputs in a fork, for what makes them may start threads, and load what that fork had to load: torch's Adam takes 2 s.

    Figures are drawn here, once: fonts are looked for in the first one.
    """
    from importlib import import_module

    receiving, sending = os.pipe()
    made = os.fork()
    if not made:
        make_inputs(inputs)
        os.write(sending, "\n".join(name for name in sys.modules if not name.startswith("__")).encode())
        os._exit(0)
    os.close(sending)
    with os.fdopen(receiving) as names:
        loaded = names.read().split("\n")
    assert os.waitpid(made, 0)[1] == 0, "the inputs could not be made"
    for name in loaded:
        if name not in sys.modules:
            with contextlib.suppress(ImportError):
                import_module(name)
    import matplotlib.pyplot as plt

    plt.figure().add_subplot().set_title("Abc 123")
    plt.savefig(io.BytesIO(), dpi=50)
    plt.close()


def options_of(verb: str) -> list[str]:
    words = [sys.executable, "-m", "preimage", verb, "--help"]
    text = subprocess.run(words, capture_output=True, text=True, check=True, stdin=subprocess.DEVNULL).stdout
    return sorted(name for name in set(re.findall(r"(?<=[\s│,])--[a-z][a-z0-9.-]*", text)) if not LEFT_OUT.match(name))


def forked(words: list[str], place: str, by: int, after_s: float | None) -> Ended:
    out, err = (tempfile.TemporaryFile() for _ in range(2))  # noqa: SIM115, closed when they were read
    began = time.monotonic()
    child = os.fork()
    if not child:
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        os._exit(code_of(words, place))
    code: int | None = None
    while True:
        if after_s is not None and time.monotonic() - began >= after_s:
            os.kill(child, by)
            after_s = None
        ended, status, usage = os.wait4(child, os.WNOHANG)
        if ended:
            code = os.waitstatus_to_exitcode(status)
            break
        if time.monotonic() - began > LONGEST_WAIT_S:
            os.killpg(child, signal.SIGKILL)
            _, _, usage = os.wait4(child, 0)
            break
        time.sleep(0.01 if after_s is None else min(0.01, max(0.0, began + after_s - time.monotonic())))
    texts = []
    for file in (out, err):
        file.seek(0)
        texts.append(file.read().decode(errors="replace"))
        file.close()
    return Ended(code, *texts, time.monotonic() - began, usage.ru_maxrss << 10)


def code_of(words: list[str], place: str) -> int:
    import resource
    import traceback

    from preimage.cli import main

    os.chdir(place)
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S + 5))
    resource.setrlimit(resource.RLIMIT_DATA, (2 * MOST_BYTES, 2 * MOST_BYTES))  # so that the machine lives on
    sys.argv = ["preimage", *words]
    code = 0
    try:
        main()
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else 0 if left.code is None else 1
    except BaseException:
        traceback.print_exc()
        code = 70
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    return code


def campaign(count: int, first: int, minutes: float) -> int:
    """So many cases; how many kinds of faults there were."""
    program, found = Program(), {}
    began = time.monotonic()
    number = first
    for number in range(first, first + count):
        if time.monotonic() - began > 60 * minutes:
            break
        fault = program.fault_of(Random(number))
        if fault and fault.law not in found:
            print(f"case {number}: {fault}\n", flush=True)
        if fault:
            found.setdefault(fault.law, []).append(number)
        if (number - first) % 500 == 499:
            print(f"{number - first + 1} cases, {sum(map(len, found.values()))} faults of {len(found)} kinds", file=sys.stderr, flush=True)
    program.close()
    print(f"{number - first + 1} cases in {time.monotonic() - began:.0f} s, {sum(map(len, found.values()))} faults of {len(found)} kinds")
    for law, numbers in sorted(found.items(), key=lambda each: -len(each[1])):
        print(f"{len(numbers):5d}  {law}: cases {' '.join(map(str, numbers[:5]))}")
    return len(found)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("count", type=int, nargs="?", default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=1e6)
    parser.add_argument("--serve", type=Path)
    asked = parser.parse_args()
    if asked.serve:
        serve(asked.serve)
    else:
        raise SystemExit(min(1, campaign(asked.count, asked.first, asked.minutes)))
