"""What the page is told when something cannot be done: one sentence, as RFC 9457 writes it (application/problem+json)."""

import json
from http import HTTPStatus
from typing import Any

MEDIA_TYPE = "application/problem+json"


class Refusal(Exception):
    """A request that cannot be served, and why.

    Args:
        status: of HTTP.
        sentence: what came, and what would do.
        retry_after_s: when it may be asked again (s).
    """

    def __init__(self, status: HTTPStatus, sentence: str, *, retry_after_s: int | None = None) -> None:
        super().__init__(sentence)
        self.status, self.sentence, self.retry_after_s = status, sentence, retry_after_s

    @property
    def headers(self) -> dict[str, str]:
        return {"Retry-After": str(self.retry_after_s)} if self.retry_after_s else {}


def problem_of(status: HTTPStatus, sentence: str) -> dict[str, Any]:
    """The members of RFC 9457; there is no page about any kind of problem, so the type is the status itself."""
    return {"type": "about:blank", "title": status.phrase, "status": int(status), "detail": sentence}


def body_of(status: HTTPStatus, sentence: str) -> bytes:
    return json.dumps(problem_of(status, sentence)).encode()
