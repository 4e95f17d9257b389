"""What the page asks for, route by route, under /api; OpenAPI describes it at /api/openapi.json."""

import json
from collections.abc import AsyncIterator
from functools import cached_property, partial
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import unquote

from fastapi import APIRouter, Body, Header, Query, Request, Response
from fastapi.responses import PlainTextResponse, StreamingResponse

from preimage.studio import planning
from preimage.studio.asked import FrameOf, Now, Pace, Place, Point, Touched, Wanted
from preimage.studio.closed import MOST_UPLOADED
from preimage.studio.goals import MOST_SEEDS, Goal, Goals
from preimage.studio.jobs import Job, Jobs
from preimage.studio.opened import OpenedRun
from preimage.studio.planning import Planned
from preimage.studio.problems import Refusal
from preimage.studio.recordings import Recordings
from preimage.studio.results import Results
from preimage.studio.touches import Touches
from preimage.studio.training_routes import add_trainings
from preimage.studio.trainings import Trainings

if TYPE_CHECKING:
    from preimage.studio.intentions import Intentions

MOST_NAME = 120
"""Letters of a picture's name that are kept."""


class Studio:
    """All that the routes speak of.

    Args:
        run: the run that was opened.
        recordings: data sets.
        trainings: runs that may be watched.
        results: folder of results.
        work: folder that starts and goals are kept in.
    """

    def __init__(
        self, run: OpenedRun, recordings: Recordings, trainings: Trainings, *, results: Path | None = None, work: Path = Path("studio")
    ) -> None:
        self.run, self.recordings, self.trainings, self.work = run, recordings, trainings, work
        self.jobs, self.goals, self.results = Jobs(), Goals(run, recordings), Results(results)

    @cached_property
    def intentions(self) -> "Intentions":
        """The plane of the run's intentions, at the first question, for its room needs torch."""
        from preimage.studio.intentions import Intentions

        return Intentions(self.run)

    def planned(self, key: str) -> Planned:
        """Raises Refusal where there is no such plan."""
        job = self.jobs.find(key)
        if not isinstance(job.result, Planned):
            raise Refusal(HTTPStatus.CONFLICT, "this plan is not found yet: wait for it, or plan again")
        return job.result

    def trusted(self, key: str) -> Planned:
        """Raises Refusal where there is no such plan, or its goal is refused and nobody said to go on anyway."""
        planned = self.planned(key)
        planned.validate_trust()
        return planned


def routes(studio: Studio) -> APIRouter:
    """The routes of one studio."""
    api = APIRouter(prefix="/api")
    add_goals(api, studio)
    add_plans(api, studio)
    add_found(api, studio)
    add_walks(api, studio)
    add_rest(api, studio)
    add_trainings(api, studio.trainings, studio.jobs)
    return api


def add_goals(api: APIRouter, studio: Studio) -> None:
    """What is wanted."""
    run, goals = studio.run, studio.goals

    @api.get("/studio", summary="What was opened: the run, its joints, presets and table, the data sets")
    def opened() -> dict[str, Any]:
        more = {"has_runs": studio.trainings.has_any, "has_results": studio.results.has_any, "most_uploaded": MOST_UPLOADED}
        return run.described() | {"data": studio.recordings.listed()} | more

    @api.get("/scene", summary="What the camera sees before anything moves")
    def scene(seed: Annotated[int, Query(ge=0, lt=MOST_SEEDS)] = 0) -> dict[str, Any]:
        return goals.start(seed)

    @api.get("/reachable", summary="Where on the picture the arm gets to, row by row")
    def reachable() -> list[str]:
        return run.table.reachable if run.table else []

    def told(goal: Goal) -> dict[str, Any]:
        return goal.described(run)

    @api.post("/goals/place", status_code=201, summary="A goal from a place on the table")
    def place(wanted: Place) -> dict[str, Any]:
        return told(goals.at_place(wanted.seed, wanted.seen))

    @api.post("/goals/picture", status_code=201, summary="A goal from a picture: its bytes, PNG, JPEG, WebP, BMP or TIFF")
    def picture(
        content: Annotated[bytes, Body(media_type="application/octet-stream")] = b"",
        seed: Annotated[int, Query(ge=0, lt=MOST_SEEDS)] = 0,
        x_name: Annotated[str, Header(description="name of the file, percent-encoded")] = "picture",
    ) -> dict[str, Any]:
        return told(goals.of_picture(content, Path(unquote(x_name)).name[:MOST_NAME] or "picture", seed))

    @api.post("/goals/frame", status_code=201, summary="A goal from a frame of a recording")
    def frame(wanted: FrameOf) -> dict[str, Any]:
        return told(goals.of_frame(wanted.data, wanted.episode, wanted.step))

    @api.post("/goals/current", status_code=201, summary="A goal from what the camera sees now")
    def current(now: Now) -> dict[str, Any]:
        trial = studio.planned(now.job).trial if now.job else None
        return told(goals.of_now(trial.frames[-1] if trial else None, now.seed))


def add_plans(api: APIRouter, studio: Studio) -> None:
    """Searches for plans, as jobs."""
    run, jobs = studio.run, studio.jobs

    @api.post("/plans", status_code=202, summary="Search for a plan; it is stopped when nobody listens to its events any more")
    def plan(wanted: Wanted) -> dict[str, Any]:
        goal = studio.goals.find(wanted.goal)
        if wanted.preset not in run.presets:
            raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, f"this run has no memory, which {wanted.preset} needs: take {run.presets[-1]}")
        work = partial(planning.plan_to, run, goal, wanted.preset, jobs)
        return account(jobs.add("plan", work, goal=goal.described(run), preset=wanted.preset))

    @api.get("/jobs", summary="All jobs that are remembered")
    def listed() -> list[dict[str, Any]]:
        return [account(job) for job in jobs.all()]

    @api.get("/jobs/{key}", summary="One job, and what was wanted of it")
    def one(key: str) -> dict[str, Any]:
        job = jobs.find(key)
        result = job.result
        trial = planning.execute(run, result) if isinstance(result, Planned) and result.trial else None
        anyway = isinstance(result, Planned) and result.anyway
        return account(job) | {"about": job.about, "execution": trial, "anyway": anyway}

    @api.get("/jobs/{key}/events", summary="What happens in a job, as server-sent events; begins again after Last-Event-ID")
    def events(key: str, request: Request, last_event_id: Annotated[int, Header()] = -1) -> StreamingResponse:
        return StreamingResponse(streamed(jobs.find(key), last_event_id, request), media_type="text/event-stream")

    @api.post("/jobs/{key}/stop", summary="Stop a job at its next step")
    def stop(key: str) -> dict[str, Any]:
        job = jobs.find(key)
        job.stop()
        return account(job)


def add_found(api: APIRouter, studio: Studio) -> None:
    """What can be done with a plan that was found."""
    run, jobs = studio.run, studio.jobs

    @api.post("/jobs/{key}/execution", summary="Let the simulated arm execute a plan, and judge where it ends")
    def execution(key: str) -> dict[str, Any]:
        return planning.execute(run, studio.planned(key))

    @api.post("/jobs/{key}/anyway", summary="Go on with a plan whose goal is refused: somebody read why")
    def anyway(key: str) -> dict[str, Any]:
        studio.planned(key).anyway = True
        return account(jobs.find(key))

    @api.post("/jobs/{key}/kept", summary="Keep start and goal on disk, so that the command line can repeat the plan")
    def kept(key: str) -> dict[str, Any]:
        planned = studio.planned(key)
        place = None if planned.goal.source else planning.keep(run, planned.goal, studio.work)
        return {"command": planning.command_of(run, planned.goal, planned.preset, place, anyway=planned.is_refused)}

    @api.get("/jobs/{key}/joints.csv", summary="The joints to command, within the limits of the demonstrations")
    def joints(key: str) -> PlainTextResponse:
        return PlainTextResponse(planning.commands_csv(run, studio.trusted(key).plan), media_type="text/csv")

    @api.get("/jobs/{key}/lerobot.zip", summary="The same as a LeRobotDataset of one episode, which lerobot-replay plays")
    def episode(key: str) -> Response:
        return Response(planning.episode_zip(run, studio.trusted(key).plan), media_type="application/zip")

    @api.get("/jobs/{key}/film.mp4", summary="The film of a plan")
    def film(key: str) -> Response:
        planned = studio.planned(key)
        return Response(planning.film_of(planned), media_type="video/mp4")


def add_walks(api: APIRouter, studio: Studio) -> None:
    """Plans that are executed with eyes open."""
    run, jobs = studio.run, studio.jobs

    @api.post("/jobs/{key}/walk", status_code=202, summary="Let the arm follow a plan, replanning at every step; stopped, it is held")
    def walk(key: str, wanted: Pace) -> dict[str, Any]:
        from preimage.studio.eyes_open import Walk

        planned = studio.planned(key)
        walked = Walk(run, planned, jobs, pace=wanted.pace)
        job = jobs.add_beside("walk", walked.go, goal=planned.goal.described(run), preset=planned.preset, plan=key)
        job.result = walked.touches
        return account(job)

    @api.post("/jobs/{key}/touch", summary="Push the hand, move the object, or want another goal, while the arm moves")
    def touch(key: str, done: Touched) -> dict[str, Any]:
        job = jobs.find(key)
        if not isinstance(job.result, Touches) or job.ended:
            raise Refusal(HTTPStatus.CONFLICT, "nothing moves now: execute a plan first")
        job.result.add(done.kind, done.seen)
        return account(job)


def add_rest(api: APIRouter, studio: Studio) -> None:
    """Intentions, recordings, results."""

    @api.get("/intentions", summary="The training intentions in two dimensions, and how what is imagined from each ends")
    async def intentions() -> dict[str, Any]:
        return await studio.jobs.by_worker(studio.intentions.map)

    @api.post("/intentions/film", summary="What is imagined from a point of the plane of intentions")
    async def imagined(wanted: Point) -> dict[str, Any]:
        return await studio.jobs.by_worker(partial(studio.intentions.film, wanted.point))

    @api.get("/data/{name}/episodes/{episode}", summary="An episode of a recording")
    def episode(name: str, episode: int) -> dict[str, Any]:
        return studio.recordings.episode(name, episode)

    @api.get("/data/{name}/findings", summary="What `preimage check` finds in a data set")
    def findings(name: str) -> dict[str, Any]:
        return studio.recordings.findings(name)

    @api.get("/results", summary="What was measured before")
    def results() -> list[dict[str, Any]]:
        return studio.results.listed()

    @api.get("/results/{name}/films/{film}", summary="A film that lies beside a result")
    def film(name: str, film: str) -> Response:
        return Response(studio.results.film(name, film), media_type="video/mp4")


def account(job: Job) -> dict[str, Any]:
    return {"job": job.id, "kind": job.kind, "state": job.state, "events": len(job.events)}


async def streamed(job: Job, after: int, request: Request) -> AsyncIterator[str]:
    """The events of a job, as they are sent."""
    async for event in job.listen(after, request.is_disconnected):
        yield ": \n\n" if event is None else f"id: {event['id']}\ndata: {json.dumps(event)}\n\n"
