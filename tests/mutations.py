"""How an input is damaged: a file of it is changed as disks, converters, editors and people change them.

A mutation changes one file or folder in place, by what a `random.Random` draws; which ones fit depends on what the file is.
"""

import csv
import io
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from PIL import Image
from safetensors.torch import load_file, save_file

from preimage.storage.checksums import is_damaged_safetensors, safetensors_with_checksum

Mutation = Callable[[Path, Random], None]

ODD_NUMBERS = [0, -1, 1, 2, 3, 0.5, -0.0, 7, 1000, 2**31, 2**63, 10**30, 1e-300, 1e18, 1e300, float("nan"), float("inf"), -float("inf")]
ODD_TEXTS = [
    *("", " ", "x", "é", "nan", "1,5", "../..", "/etc/passwd", "/dev/zero", ".", "0", "-1", "1e999", "true", "a\nb", "a\0b", "a" * 5000),
    *("{episode_index:09999999d}", "{}", "{0}", "{x!r}", "%s", "²", "\udc80"),
    *("deg", "rpm", "mm", "float32", "video", "int8", "v3.0", "v9.9"),
]
ODD_VALUES = [None, True, False, [], {}, [[]], [None], {"": {}}, [1, [2, [3]]], *ODD_NUMBERS, *ODD_TEXTS]


def any_value(chance: Random) -> Any:
    return chance.choice(ODD_VALUES)


# Any file


def cut_short(path: Path, chance: Random) -> None:
    os.truncate(path, int(chance.random() * path.stat().st_size))


def flip_bytes(path: Path, chance: Random) -> None:
    content = bytearray(path.read_bytes())
    for _ in range(chance.choice([1, 1, 3, 30]) if content else 0):
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    path.write_bytes(content)


def zero_a_part(path: Path, chance: Random) -> None:
    content = bytearray(path.read_bytes())
    start, length = chance.randrange(len(content) + 1), chance.choice([4, 64, 4096])
    content[start : start + length] = bytes(len(content[start : start + length]))
    path.write_bytes(content)


def replace_by_something_else(path: Path, chance: Random) -> None:
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12\n"
    archive, pickled, nested = b"PK\x05\x06" + bytes(18), b"\x80\x04.", b"[" * 20_000
    path.write_bytes(chance.choice([b"", b"\0", b"\n", pointer, b"{}", b"[]", b"null", pickled, archive, nested]))


def put_a_mark_before(path: Path, _chance: Random) -> None:
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())


def take_away(path: Path, _chance: Random) -> None:
    path.unlink()


def rename(path: Path, chance: Random) -> None:
    names = ["x", "é", ".hidden", "1e9.png", path.stem, *(stem + path.suffix for stem in ("²", "new", "-5"))]
    path.rename(path.with_name(chance.choice(names)))


def copy_beside(path: Path, chance: Random) -> None:
    other = path.with_name(chance.choice(["copy", "9" + path.name, "2.png", "07.png", "joints (1).csv", "notes.txt"]))
    if not other.exists():
        shutil.copy(path, other)


def make_a_folder_of_it(path: Path, _chance: Random) -> None:
    path.unlink()
    path.mkdir()


def make_a_pipe_of_it(path: Path, _chance: Random) -> None:
    path.unlink()
    os.mkfifo(path)


def make_a_link_of_it(path: Path, chance: Random) -> None:
    path.unlink()
    path.symlink_to(chance.choice(["/dev/zero", "/dev/null", path.name, "nowhere", ".."]))


def take_the_folder_away(path: Path, _chance: Random) -> None:
    shutil.rmtree(path.parent)


def copy_the_folder(path: Path, _chance: Random) -> None:
    other = path.parent.with_name(f"{path.parent.name} copy")
    if not other.exists():
        shutil.copytree(path.parent, other, symlinks=True)


# Text


def change_a_value(content: Any, chance: Random, value: Any) -> Any:
    """JSON with something in it, at whatever depth, replaced, taken out, doubled or renamed."""
    if isinstance(content, dict) and content and chance.random() < 0.85:
        name = chance.choice(list(content))
        what = chance.randrange(10)
        if what == 0:
            return {key: each for key, each in content.items() if key != name}
        if what == 1:
            return {("x" if key == name else key): each for key, each in content.items()}
        return content | {name: change_a_value(content[name], chance, value)}
    if isinstance(content, list) and content and chance.random() < 0.85:
        place, what = chance.randrange(len(content)), chance.randrange(10)
        if what == 0:
            return content[:place] + content[place + 1 :]
        if what == 1:
            return [*content, content[place]]
        return [*content[:place], change_a_value(content[place], chance, value), *content[place + 1 :]]
    return value


def change_json(path: Path, chance: Random) -> None:
    changed = change_a_value(json.loads(path.read_text()), chance, any_value(chance))
    path.write_text(json.dumps(changed))


def change_a_line_of_json(path: Path, chance: Random) -> None:
    lines = path.read_text().splitlines() or ["{}"]
    place, what = chance.randrange(len(lines)), chance.randrange(6)
    if what == 0:
        del lines[place]
    elif what == 1:
        lines.append(lines[place])
    elif what == 2:
        chance.shuffle(lines)
    elif what == 3:
        lines.insert(place, chance.choice(["", "x", "null", "[]", "{", "\ufeff"]))
    else:
        lines[place] = json.dumps(change_a_value(json.loads(lines[place]), chance, any_value(chance)))
    path.write_text("\n".join(lines) + "\n")


def change_a_table(path: Path, chance: Random) -> None:
    rows = list(csv.reader(io.StringIO(path.read_text()))) or [[""]]
    row, what, separator = chance.choice(rows), chance.randrange(8), ","
    column = chance.randrange(len(rows[0]) or 1)
    if what <= 2 and row:
        row[chance.randrange(len(row))] = str(any_value(chance)).encode(errors="replace").decode()
    elif what == 3:
        for each in rows:
            del each[column : column + 1]
    elif what == 4:
        rows[0] = [rows[0][0]] * len(rows[0])
    elif what == 5:
        del rows[0]
    elif what == 6:
        del row[column:]
    else:
        separator = chance.choice([";", "\t", " ", "|", ", "])
    path.write_text("\n".join(separator.join(each) for each in rows) + "\n")


def write_otherwise(path: Path, chance: Random) -> None:
    text = path.read_text()
    others = [text.encode("utf-16"), text.replace("\n", "\r\n").encode(), text.replace(".", ",").encode(), b'"' + text.encode()]
    path.write_bytes(chance.choice(others))


# Parquet, arrays, tensors, pictures, films


TYPES = [pa.float32(), pa.float64(), pa.float16(), pa.int8(), pa.int64(), pa.bool_(), pa.string(), pa.binary(), pa.null()]
TYPES += [pa.list_(pa.float32())]


def change_a_column(path: Path, chance: Random) -> None:
    table = pq.read_table(path)
    place, what = chance.randrange(max(1, table.num_columns)), chance.randrange(9)
    name, rows = table.column_names[place], table.num_rows
    if what == 0:
        table = table.drop_columns([name])
    elif what == 1:
        other = chance.choice(["x", "", *table.column_names])
        table = table.rename_columns([other if each == name else each for each in table.column_names])
    elif what == 2:
        table = table.slice(0, chance.choice([0, 1, max(0, rows - 1)]))
    elif what == 3:
        table = pa.concat_tables([table, table.slice(0, chance.choice([1, rows]))])
    elif what == 4 and rows:
        table = table.take(pa.array(sorted(range(rows), key=lambda _: chance.random())))
    else:
        values = table.column(place).to_pylist()
        value = any_value(chance)
        for row in range(rows) if chance.random() < 0.5 else [chance.randrange(rows)] if rows else []:
            values[row] = change_a_value(values[row], chance, value) if what == 5 else value
        kind = table.schema.field(place).type if what < 8 else chance.choice(TYPES)
        try:
            column = pa.array(values, kind)
        except (pa.ArrowException, OverflowError, TypeError, ValueError):
            column = pa.array([None] * rows, kind)
        table = table.set_column(place, name, column)
    pq.write_table(table, path)


def changed_array(array: np.ndarray, chance: Random) -> np.ndarray:
    what = chance.randrange(8)
    with np.errstate(all="ignore"):
        if what == 0:
            return array.astype(chance.choice(["f2", "f8", "i1", "u1", "i8", "?", "c8", "U3"]))
        if what == 1:
            return array[: chance.randrange(len(array) + 1)] if array.ndim else array[None]
        if what == 2:
            return array[..., None]
        if what == 3:
            return array.reshape(-1)
        if what == 4:
            return np.concatenate([array, array]) if array.ndim else array
        if what == 5:
            return np.array([None, "x"], object)
        array = array.copy() if what == 6 else array.astype(float)
        number = chance.choice(ODD_NUMBERS)
        if array.dtype.kind in "iu":
            number = max(np.iinfo(array.dtype).min, min(np.iinfo(array.dtype).max, int(np.nan_to_num(min(max(number, -1e18), 1e18)))))
        array.reshape(-1)[: chance.choice([1, array.size])] = number
        return array


def change_arrays(path: Path, chance: Random) -> None:
    with np.load(path) as file:
        arrays = dict(file)
    name = chance.choice(sorted(arrays))
    what = chance.randrange(8)
    if what == 0:
        del arrays[name]
    elif what == 1:
        arrays["x"] = arrays.pop(name)
    else:
        arrays[name] = changed_array(arrays[name], chance)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def change_tensors(path: Path, chance: Random) -> None:
    """With a right checksum again, so that what is behind it is reached."""
    tensors, sealed = load_file(path), not is_damaged_safetensors(path.read_bytes())
    name, what = chance.choice(sorted(tensors)), chance.randrange(6)
    if what == 0:
        del tensors[name]
    elif what == 1:
        tensors["x"] = tensors.pop(name)
    else:
        array = tensors[name].float().numpy() if tensors[name].dtype == torch.bfloat16 else tensors[name].numpy()
        changed = changed_array(array, chance)
        tensors[name] = torch.from_numpy(np.ascontiguousarray(changed if changed.dtype.kind in "fiub" else array))
    if sealed:
        path.write_bytes(safetensors_with_checksum(tensors))
    else:
        save_file(tensors, path)


def save_another_model(path: Path, chance: Random) -> None:
    tensors = {f"model.layers.{layer}.self_attn.q_proj.weight": torch.ones(4, 4) for layer in range(2)}
    if chance.random() < 0.5:
        save_file(tensors, path, metadata={"format": "pt"})
    else:
        torch.save(tensors, path)


def change_a_picture(path: Path, chance: Random) -> None:
    with Image.open(path) as image:
        image.load()
    mode = chance.choice(["1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "I;16", "F", "I"])
    size = chance.choice([image.size, (1, 1), (1, 3000), (97, 61)])
    kind = chance.choice(["PNG", "JPEG", "GIF", "BMP", "TIFF", "WEBP", "PPM"])
    try:
        image.convert("L" if mode in ("I;16", "F", "I") else "RGB").convert(mode).resize(size).save(path, kind)
    except (OSError, ValueError, KeyError):
        Image.new("L", size).save(path, "PNG")


def of_suffix(path: Path) -> list[Mutation]:
    """The mutations that know what such a file holds."""
    return {
        ".json": [change_json, change_json, change_json, write_otherwise],
        ".jsonl": [change_a_line_of_json, change_a_line_of_json, write_otherwise],
        ".csv": [change_a_table, change_a_table, write_otherwise],
        ".parquet": [change_a_column] * 4,
        ".npz": [change_arrays] * 3,
        ".safetensors": [change_tensors, change_tensors, save_another_model],
        ".pt": [save_another_model],
        ".png": [change_a_picture] * 2,
        ".jpg": [change_a_picture] * 2,
    }.get(path.suffix, [])


OF_ANY_FILE: list[Mutation] = [
    *(cut_short, cut_short, flip_bytes, flip_bytes, zero_a_part, replace_by_something_else, put_a_mark_before, take_away, rename),
    *(copy_beside, make_a_folder_of_it, make_a_pipe_of_it, make_a_link_of_it, take_the_folder_away, copy_the_folder),
]


def damage(root: Path, chance: Random) -> str:
    """Change one file of an input, or the input where it is a file; what was done, in words."""
    files = [root] if root.is_file() else sorted(path for path in root.rglob("*") if path.is_file() and not path.is_symlink())
    files = [path for path in files if path.stat().st_size] or files
    if not files:
        return "nothing left to change"
    by_kind: dict[tuple[Path, str], list[Path]] = {}
    for path in files:
        by_kind.setdefault((path.parent, path.suffix), []).append(path)  # or it would nearly always be one of many pictures
    path = chance.choice(by_kind[chance.choice(sorted(by_kind))])
    knowing = of_suffix(path)
    mutation = chance.choice(knowing if knowing and chance.random() < 0.65 else OF_ANY_FILE)
    if path == root and mutation in (take_the_folder_away, copy_the_folder):
        mutation = take_away
    try:
        mutation(path, chance)
    except Exception as error:  # an earlier mutation left nothing that could be opened
        return f"{path.relative_to(root.parent)}: {mutation.__name__} ({type(error).__name__})"
    return f"{path.relative_to(root.parent)}: {mutation.__name__}"
