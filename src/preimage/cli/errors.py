"""What goes wrong, in one sentence and an exit code: whose fault it is, and what would do.

Exit code 2: the words or the files of the user are off. 1: the work failed, was interrupted, or there is an error inside preimage.

A `ValueError` is the user's where preimage raised it itself, for then it was looked for and has a sentence. One that comes out of a
library, or out of an expression, was not foreseen: it is an error inside preimage, and is reported as one.
"""

import dis
import os
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import metadata
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import NoReturn

ROOT = Path(__file__).parents[1]
RAISE = dis.opmap["RAISE_VARARGS"]


@contextmanager
def one_sentence(verb: str, words: list[str]) -> Iterator[None]:
    """Whatever goes wrong inside ends in one sentence and an exit code.

    Args:
        words: what follows the verb on the command line.
    """
    try:
        validate_words(words)
        yield
    except KeyboardInterrupt:
        fail(f"interrupted; {what_is_kept(verb, words)}", code=1)
    except OSError as error:
        fail(sentence_of(error), code=1)
    except MemoryError:
        fail("the memory of this machine is too small for it: give a smaller size, smaller pictures or fewer of them", code=1)
    except Exception as error:
        if isinstance(error, ValueError) and is_raised_here(error.__traceback__):
            fail(one_line(str(error)), code=2)
        if type(error).__module__.startswith("preimage."):  # work that failed: NonFinite, ProcessLost
            fail(one_line(str(error)), code=1)
        if type(error).__name__ == "OutOfMemoryError":  # of torch, which is not imported for it
            fail("the memory of the device is too small for it: give a smaller --batch-size or size, or --device cpu", code=1)
        fail(report_of(error), code=1)


def what_is_kept(verb: str, words: list[str]) -> str:
    """What a verb has kept when it is interrupted; all but two write at their end, as a whole."""
    if verb == "reproduce":
        return "what is done is kept, and the same command goes on"
    out = next((Path(value) for word, value in pairwise(words) if word == "--out"), None)
    if verb != "train" or out is None or not (out / "config.json").is_file():
        return "nothing was written"
    if (out / "resume.pt").is_file():
        return "what was saved is kept, and --resume goes on with it"
    return f"{out} has no checkpoint yet, and --resume begins again"


def validate_words(words: list[str]) -> None:
    """Raises ValueError where a word is no text, which nothing could print or write down."""
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError as error:
            raise ValueError(f"{word.encode(errors='surrogateescape')!r} is no text in UTF-8: rename the file or folder") from error
        if "\0" in word:
            raise ValueError(f"{word!r} holds a character of number 0: leave it out")


def is_raised_here(trace: TracebackType | None) -> bool:
    """Whether an error comes out of a `raise` in preimage, and not out of a library or an expression."""
    if trace is None:
        return False
    while trace.tb_next is not None:
        trace = trace.tb_next
    code = trace.tb_frame.f_code
    return Path(code.co_filename).is_relative_to(ROOT) and code.co_code[trace.tb_lasti] == RAISE


def sentence_of(error: OSError) -> str:
    """What the operating system refused, without its number."""
    if isinstance(error, FileExistsError) and error.strerror == os.strerror(error.errno or 0):
        return f"{error.filename} is there already and is no folder: give another place"
    if error.filename:
        return f"{error.filename}: {error.strerror}"
    return error.strerror or one_line(str(error)) or type(error).__name__


def report_of(error: Exception) -> str:
    """That there is an error inside preimage, where it came up, and where to report it."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename).is_relative_to(ROOT)]
    place = f", in {Path(frames[-1].filename).relative_to(ROOT.parent)}, line {frames[-1].lineno}" if frames else ""
    trace = Path(tempfile.gettempdir()) / f"preimage-error-{os.getpid()}.txt"
    with suppress(OSError):
        trace.write_text("".join(traceback.format_exception(error)), encoding="utf-8", errors="backslashreplace")
    with_it = f"your command and {trace}" if trace.is_file() else "your command"
    return (
        f"an error inside preimage ({type(error).__name__}{place}): it is not yours; please report it {where_to_report()}, with {with_it}"
    )


def where_to_report() -> str:
    """The page of issues, as the package names it, or else whom the package names as its authors."""
    urls = dict(each.split(", ", 1) for each in metadata("preimage").get_all("Project-URL") or ())
    return f"at {urls['Issues']}" if "Issues" in urls else "to the preimage authors, where you got preimage from"


def one_line(text: str) -> str:
    """The text with its line breaks as spaces."""
    return " ".join(text.split("\n"))


def fail(sentence: str, *, code: int) -> NoReturn:
    """Leave with one sentence, printed once where several processes of a machine leave together."""
    if is_first_here():
        print(f"preimage: {sentence}", file=sys.stderr)
    raise SystemExit(code)


def is_first_here() -> bool:
    """Whether this is the first, or the only, of the processes that work together on this machine."""
    return int(os.environ.get("LOCAL_RANK", os.environ.get("SLURM_LOCALID", "0"))) == 0
