"""The words after a verb, parsed: what fits no option is answered in one sentence, with the option that was meant."""

import contextlib
import io
import itertools
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from functools import partial, wraps

from preimage.cli.errors import fail

MISREAD = re.compile(r"Error parsing (--[^\s:]+):")
NOT_AMONG = re.compile(r"invalid choice .* for argument '(--\S+)'. Expected one of \((.*?)\)")
LACKING = re.compile(r"value for argument '(--\S+)'")
"""What the parser says of a value of another type than its option's, of a word that is no choice, and of an option without value."""
NUMBERS = {"INT": "whole number", "FLOAT": "number"}
"""What the help's words for numbers mean."""


def parsed(function: Callable[..., None], words: list[str], *, prog: str) -> Callable[[], None]:
    """The work that a verb and its words ask for; the process is left, with exit code 2, where they ask for none.

    Args:
        prog: what the program and the verb are called in the help.
    """
    import tyro

    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(_later(function), prog=prog, args=words)
    except SystemExit as left:
        if left.code and (sentence := _what_is_wrong_with(words, said.getvalue(), function, prog)):
            fail(sentence, code=2)
        print(said.getvalue(), end="", file=sys.stderr)
        raise


def _later(function: Callable[..., None]) -> Callable[..., Callable[[], None]]:
    """A function of the same words that does nothing yet."""
    if isinstance(function, partial):
        return partial(_later(function.func), *function.args, **function.keywords)

    @wraps(function)
    def later(*args: object, **kwargs: object) -> Callable[[], None]:
        return partial(function, *args, **kwargs)

    return later


def _what_is_wrong_with(words: Sequence[str], said: str, function: Callable[..., None], prog: str) -> str | None:
    """One sentence on a word that is no option, or a value that does not fit one; None where the parser's own words are as good."""
    from preimage.cli.completion import options_of

    options = ["--help", *options_of(function)]
    given = [word.split("=")[0] for word in words if word.startswith("--")]
    if unknown := [word for word in given if word.replace("_", "-") not in options]:
        near = get_close_matches(unknown[0].lower(), options, n=1)
        return f"there is no option {unknown[0]}: " + (f"did you mean {near[0]}?" if near else f"{prog} --help says which there are")
    said = re.sub(r"[\s│]*\n[\s│]*", " ", said)  # lines, in a frame where there is one
    if found := MISREAD.search(said):
        return f"{found[1]} is {_value_of(found[1], words)}: give {_numbers_for(found[1], said)}"
    if found := NOT_AMONG.search(said):
        *others, last = re.findall(r"'(\w+)'", found[2].replace("'None'", ""))
        return f"{found[1]} is {_value_of(found[1], words)}: give {', '.join(others)} or {last}"
    if found := LACKING.search(said):
        return f"{found[1]} has no value: give one after it"
    return None


def _value_of(option: str, words: Sequence[str]) -> str:
    """The words after an option, as they were given."""
    given = [word.split("=", 1) for word in words]
    place = next(place for place, word in enumerate(given) if word[0].replace("_", "-") == option)
    values = itertools.takewhile(lambda word: not word.startswith("--"), [*given[place][1:], *words[place + 1 :]])
    return shlex.join(values)


def _numbers_for(option: str, said: str) -> str:
    """How many numbers of which type an option takes, by its row in the help.

    >>> _numbers_for("--size", "--size {None}|{INT INT} Height and width."), _numbers_for("--rate", "--rate {None}|FLOAT Steps a second.")
    ('2 whole numbers', 'a number')
    """
    row = re.search(rf"{re.escape(option)} ((?:\{{None\}}\|)?[][{{}}A-Z .]*)", said)
    kinds = re.findall("INT|FLOAT", row[1] if row else "")
    if not kinds:
        return "what `--help` says of it"
    if row and "..." in row[1]:
        return f"{NUMBERS[kinds[0]]}s, one after the other"
    return f"a {NUMBERS[kinds[0]]}" if len(kinds) == 1 else f"{len(kinds)} {NUMBERS[kinds[0]]}s"
