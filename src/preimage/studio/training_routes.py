"""What the page asks of trainings, under /api/runs."""

from functools import partial
from typing import Any

from fastapi import APIRouter

from preimage.studio.asked import Training
from preimage.studio.jobs import Jobs
from preimage.studio.trainings import Trainings


def add_trainings(api: APIRouter, trainings: Trainings, jobs: Jobs) -> None:
    """Trainings, watched, begun, stopped and resumed."""

    @api.get("/runs", summary="Trainings, and how far they are")
    def runs() -> list[dict[str, Any]]:
        return trainings.listed()

    @api.post("/runs", status_code=202, summary="Begin a training, as a process of its own")
    def begin(wanted: Training) -> dict[str, Any]:
        return trainings.begin(wanted.data, wanted.name, size=wanted.size, preset=wanted.preset, updates=wanted.updates)

    @api.post("/runs/{name}/stop", summary="Stop a training that was begun here after its running update, which is kept")
    def stop(name: str) -> dict[str, Any]:
        return trainings.stop(name)

    @api.post("/runs/{name}/resume", status_code=202, summary="Go on with a training that was stopped")
    def resume(name: str) -> dict[str, Any]:
        return trainings.resume(name)

    @api.get("/runs/{name}/film", summary="The first training sequence as the last checkpoint regenerates it")
    async def film(name: str) -> dict[str, Any]:
        return await jobs.by_worker(partial(trainings.film, name))
