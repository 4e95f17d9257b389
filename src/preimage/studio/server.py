"""The application and the server: what is sent for which address, and to whom."""

import secrets
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial
from http import HTTPStatus
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import uvicorn
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from starlette.exceptions import HTTPException

from preimage.studio.api import Studio, routes
from preimage.studio.closed import LOOPBACK, Closed
from preimage.studio.jobs import sentence_of
from preimage.studio.opened import OpenedRun
from preimage.studio.problems import MEDIA_TYPE, Refusal, problem_of

if TYPE_CHECKING:
    from preimage.ideas.watched import Considered

KINDS = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
"""What the page is made of."""


def application(studio: Studio, *, token: str | None = None) -> Closed:
    """The studio behind its wall.

    Args:
        token: what a request has to know; None on the loopback interface.
    """

    @asynccontextmanager
    async def until_closed(_: FastAPI) -> AsyncIterator[None]:
        yield
        studio.trainings.trainer.close()

    addresses = {"docs_url": None, "redoc_url": None, "openapi_url": "/api/openapi.json"}
    app = FastAPI(title="preimage studio", version="1", lifespan=until_closed, **addresses)
    app.include_router(routes(studio))
    add_page(app)
    add_problems(app)
    return Closed(app, token=token)


def add_page(app: FastAPI) -> None:
    """The files of the page, read once; there are no others to be asked for."""
    shared, own = resources.files("preimage.report") / "design.css", resources.files("preimage.studio") / "static"
    files = {each.name: each.read_bytes() for each in (shared, *own.iterdir()) if Path(each.name).suffix in KINDS}

    @app.get("/{name:path}", include_in_schema=False)
    def page(name: str) -> Response:
        name = name or "index.html"
        if name not in files:
            raise Refusal(HTTPStatus.NOT_FOUND, f"there is no {name[:80]} here: the page is at /")
        return Response(files[name], media_type=KINDS[Path(name).suffix])


def add_problems(app: FastAPI) -> None:
    """Whatever goes wrong is told in one sentence."""

    @app.exception_handler(Refusal)
    async def refused(_: Request, error: Refusal) -> Response:
        return problem(error.status, error.sentence, error.headers)

    @app.exception_handler(ValueError)
    async def wrong(_: Request, error: ValueError) -> Response:
        return problem(HTTPStatus.UNPROCESSABLE_ENTITY, sentence_of(error))

    @app.exception_handler(RequestValidationError)
    async def unlike(_: Request, error: RequestValidationError) -> Response:
        first: dict[str, Any] = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"][1:]) or "the request"
        return problem(HTTPStatus.UNPROCESSABLE_ENTITY, f"{where}: {first['msg'][0].lower()}{first['msg'][1:]}")

    @app.exception_handler(HTTPException)
    async def other(_: Request, error: HTTPException) -> Response:
        status = HTTPStatus(error.status_code)
        return problem(status, f"{status.phrase.lower()}: /api/openapi.json says what can be asked for", dict(error.headers or {}))

    @app.exception_handler(Exception)  # which is raised again afterwards, so that the terminal shows it
    async def unforeseen(_: Request, error: Exception) -> Response:
        return problem(HTTPStatus.INTERNAL_SERVER_ERROR, sentence_of(error))


def problem(status: HTTPStatus, sentence: str, headers: dict[str, str] | None = None) -> Response:
    return JSONResponse(problem_of(status, sentence), int(status), headers=headers, media_type=MEDIA_TYPE)


def serve(studio: Studio, *, host: str, port: int, ready: Callable[[str], None]) -> None:
    """Serve until it is interrupted.

    Args:
        port: 0 takes any that is free.
        ready: called with the address of the page once it can be opened.

    Raises:
        OSError: the port is taken, or the address is none of this machine's.
    """
    token = None if host in LOOPBACK else secrets.token_urlsafe(24)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen()  # whoever opens the address at once waits until the server is up, and is not refused
        number = listening.getsockname()[1]
        config = uvicorn.Config(application(studio, token=token), log_level="error", access_log=False, timeout_graceful_shutdown=1)
        studio.jobs.errand(partial(warm_up, studio.run))
        shown = f"[{host}]" if ":" in host else host
        ready(f"http://{shown}:{number}/" + (f"#token={token}" if token else ""))
        uvicorn.Server(config).run([listening])


class Woken(Exception):
    """Ends the search of `warm_up`."""


def warm_up(run: OpenedRun) -> None:
    """Load the network, and let it imagine once, so that whoever asks first waits no longer than others; a fault is told when it is met."""
    from preimage.network.inputs import home

    def wake(_: "Considered") -> None:
        raise Woken

    with suppress(ValueError, Woken):
        planner = run.planner(run.presets[-1])
        start = home(planner.model)
        planner.watched(wake).plan(start=start, goal=start)
