"""What a file of a data set must be before it is opened: there, a regular file, no Git LFS pointer, and no larger than is plausible.

A named pipe would block for ever, and a pointer of three lines is what a clone without git-lfs leaves of every large file.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

AGAIN = "copy the data set again"
POINTER = b"version https://git-lfs"
"""How a Git LFS pointer begins."""
HALF = "holds half a character, which is no text"
"""What is said of JSON that `loads` refuses so."""
MOST_TEXT_BYTES = 512 * 2**20
"""A file of text that is larger than this is no description, index or table of joints."""


def leave_out(episode: int) -> str:
    """What a user can do about an episode that is damaged.

    >>> leave_out(3)
    'copy the data set again or leave that episode out (--without-episodes 3)'
    """
    return f"{AGAIN} or leave that episode out (--without-episodes {episode})"


def is_pointer(content: bytes) -> bool:
    return content.startswith(POINTER)


def validate_file(path: Path) -> None:
    """Raises ValueError where the path is missing, no regular file, or a Git LFS pointer."""
    if not path.exists():
        raise ValueError(f"{path} is missing: {AGAIN}")
    if not path.is_file():
        raise ValueError(f"{path} is not a regular file: put the file itself there")
    with path.open("rb") as file:
        if is_pointer(file.read(len(POINTER))):
            raise ValueError(f"{path} is a Git LFS pointer, not the file itself: run `git lfs pull` in the folder of the data set")


def read_text(path: Path) -> str:
    """The text of a file, its byte-order mark left out.

    Raises:
        ValueError: the file is missing, no regular file, a Git LFS pointer, or far too large; or it is no text.
    """
    validate_file(path)
    if (size := path.stat().st_size) > MOST_TEXT_BYTES:
        raise ValueError(f"{path} holds {size / 2**20:.0f} MB, more than such a file can need ({MOST_TEXT_BYTES / 2**20:.0f} MB)")
    content = path.read_bytes()
    wide = content[:2] in (b"\xff\xfe", b"\xfe\xff")  # what spreadsheets call "Unicode text"
    try:
        return content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not text in UTF-8: save it as UTF-8, or {AGAIN}") from error


def read_json(path: Path) -> dict[str, Any]:
    """The JSON object in a file.

    Raises:
        ValueError: there is none.
    """
    return parse_json(read_text(path), str(path))


def read_json_lines(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Number and content of each line that holds a JSON object; blank lines are passed over.

    Raises:
        ValueError: a line holds something else.
    """
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.strip():
            yield number, parse_json(line, f"{path}, line {number}")


def parse_json(text: str, where: str) -> dict[str, Any]:
    try:
        content = loads(text)
    except UnicodeEncodeError as error:
        raise ValueError(f"{where} {HALF}: write it anew") from error
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{where} is not JSON: the file is damaged, {AGAIN}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{where} holds a {type(content).__name__}, not an object: the file is damaged, {AGAIN}")
    return content


def loads(text: str) -> Any:
    r"""What a text in JSON holds.

    Raises:
        UnicodeEncodeError: half a character is in it, as in "\ud83d", which nothing could print or write down.
        ValueError: it is no JSON.
    """
    content = json.loads(text)
    if "\\u" in text:
        json.dumps(content, ensure_ascii=False).encode()
    return content


def is_count(value: Any) -> bool:
    """Whether a value out of JSON or parquet is a whole number of 0 or more; True is none.

    >>> is_count(3), is_count(-1), is_count(True), is_count("3")
    (True, False, False, False)
    """
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0
