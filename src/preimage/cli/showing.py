"""The verb that opens a page: studio."""

import webbrowser
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from preimage.cli.screen import remark

HIGHEST_PORT = 65_535
NEEDED = ("fastapi", "uvicorn")
"""What the extra `studio` brings."""


def studio(
    run: Positional[str] = "reach",
    data: tuple[Path, ...] = (),
    runs: tuple[Path, ...] = (),
    results: Path | None = None,
    work: Path = Path("studio"),
    host: str = "127.0.0.1",
    port: int = 8230,
    open_: Annotated[bool, tyro.conf.arg(name="open")] = False,
) -> None:
    """Open a local page: click a goal, watch how it is imagined, and let the arm move.

    Args:
        run: a run folder, the name of a bundled model, or hf:OWNER/NAME of the Hugging Face Hub.
        data: data sets whose episodes are shown, whose frames may be goals, and on which the page may train.
        runs: run folders, or folders of them, whose trainings are shown as they go on; new ones begin in the first folder of them.
        results: folder of the JSON files of evaluations.
        work: folder that starts and goals are kept in, when the page is asked for the command that repeats a plan, and in its `runs`
            new trainings, where --runs names no folder of them.
        host: address to listen at; any other than this machine's own asks for the token that is printed.
        port: of the page; 0 takes any that is free.
        open_: open it in the browser at once.
    """
    if missing := [name for name in NEEDED if find_spec(name) is None]:
        raise ValueError(f"the studio needs {' and '.join(missing)}: pip install 'preimage[studio]', or make studio")
    if not 0 <= port <= HIGHEST_PORT:
        raise ValueError(f"--port is {port}: give 0 to {HIGHEST_PORT}")
    if results and not results.is_dir():
        raise ValueError(f"--results is {results}, which is no folder: give the one that holds the JSON files")
    from preimage.studio.api import Studio
    from preimage.studio.opened import OpenedRun
    from preimage.studio.recordings import Recordings
    from preimage.studio.server import serve
    from preimage.studio.trainings import Trainings

    opened = OpenedRun(run)
    recordings = Recordings(data, opened.view)
    shown = Studio(opened, recordings, Trainings(runs, recordings, into=work / "runs"), results=results, work=work)

    def ready(address: str) -> None:
        print(f"open {address}", flush=True)
        remark("it goes on until you press Ctrl-C; nothing leaves this machine")
        if open_:
            webbrowser.open(address)

    serve(shown, host=host, port=port, ready=ready)
