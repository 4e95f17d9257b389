"""Checksums inside the files that hold weights, so that a bit that flipped on a disk is noticed before anything is computed with it.

Both kinds of file stay what they were: PyTorch and safetensors read them without this program. A file from before there were checksums has
none, and is believed.

>>> sealed = with_checksum_in_zip(saved_by_torch({"update": 3}))
>>> is_damaged_zip(sealed), is_damaged_zip(sealed[:60] + b"?" + sealed[61:])
(False, True)
"""

import hashlib
import io
import re
from typing import Any

import torch
from safetensors.torch import save
from torch import Tensor

ZIP_END, ZIP_END_LENGTH = b"PK\x05\x06", 22
"""The record with which a zip file ends, where no comment follows it."""
MARK = b"sha256:"
NO_DIGEST = "0" * 64
IN_HEADER = re.compile(rb'(?<="sha256":")[0-9a-f]{64}(?=")')


def saved_by_torch(state: dict[str, Any]) -> bytes:
    """What `torch.save` writes."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    return buffer.getvalue()


def with_checksum_in_zip(content: bytes) -> bytes:
    """A zip file, as torch.save writes it, with the checksum of all of it as the comment at its end."""
    assert content[-ZIP_END_LENGTH:].startswith(ZIP_END), "a zip file without a comment"
    length = len(MARK) + len(NO_DIGEST)
    body = content[:-2] + length.to_bytes(2, "little") + MARK
    return body + hashlib.sha256(body).hexdigest().encode()


def is_damaged_zip(content: bytes) -> bool:
    """Whether a zip file is another than it was when `with_checksum_in_zip` made it."""
    if content[-ZIP_END_LENGTH:].startswith(ZIP_END):
        return False  # from before there were checksums
    body, digest = content[: -len(NO_DIGEST)], content[-len(NO_DIGEST) :]
    return not body.endswith(MARK) or hashlib.sha256(body).hexdigest().encode() != digest


def safetensors_with_checksum(tensors: dict[str, Tensor]) -> bytes:
    """A safetensors file whose metadata hold the checksum of all of it, taken while zeros stood in its place."""
    content = save(tensors, metadata={"sha256": NO_DIGEST})
    return IN_HEADER.sub(hashlib.sha256(content).hexdigest().encode(), content, count=1)


def is_damaged_safetensors(content: bytes) -> bool:
    """Whether a safetensors file is another than it was when `safetensors_with_checksum` made it."""
    if b"sha256" not in content and b"__metadata__" not in content:
        return False  # from before there were checksums
    found = IN_HEADER.search(content)
    if not found:
        return True
    plain = content[: found.start()] + NO_DIGEST.encode() + content[found.end() :]
    return hashlib.sha256(plain).hexdigest().encode() != found[0]
